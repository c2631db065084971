"""Name the components of hybrids."""

SIMULATOR, NETWORK = "simulator", "network"
"""Beginnings of the labels of the two components."""
