"""Define fits without a network: seasonal, trend, harmonic, periodic and linear."""
