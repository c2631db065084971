"""Comparing forecasters: both protocols, held-out trials, selection, prediction intervals."""
