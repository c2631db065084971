"""Name the components of hybrids."""

SLOW, FAST = "simulator", "network"
"""Beginnings of the labels of the two components."""
