"""Fit functions of time: seasonal, sinusoids and periodic waveforms."""
