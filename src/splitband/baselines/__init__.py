"""Fit baselines without networks: seasonal, trend, harmonic, periodic and linear."""
