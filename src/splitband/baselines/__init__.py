"""Forecasters without a network: mean, persistence, seasonal, trend, harmonic, periodic, linear."""
