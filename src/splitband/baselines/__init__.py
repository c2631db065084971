"""Fit baselines, which need no network: seasonal, trend, harmonic, periodic and linear."""
