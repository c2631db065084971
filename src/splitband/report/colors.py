"""Define colours of methods, equal in all pictures and plots of the page."""

_FIRST = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B27A00", "#6A3D9A"
PALETTE = *_FIRST, "#8C564B", "#C2185B", "#7F7F00", "#3A93CC", "#1B7837", "#283593"
"""Colours on white, of different lightness for colour-blind readers."""
_DARK = "#4FA8E0", "#FF8A3D", "#2FC79A", "#E59BC4", "#F0B429", "#B48FE0"
DARK = *_DARK, "#C99A8C", "#FF80AB", "#C2C24A", "#8CCBF2", "#66C281", "#9FA8FF"
"""The same hues on a dark page."""
