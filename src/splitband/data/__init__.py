"""Measured records: the data container, readers for the usual files, and the public records."""

from splitband.data.alignment import Aligned, aligned, resampled
from splitband.data.public import PUBLIC, PublicFile, double_torsion, drill_string, fetch
from splitband.data.reading import read
from splitband.data.timing import Grid, Stamp
from splitband.data.trajectory import Trajectory, check_alike

__all__ = [
    "PUBLIC",
    "Aligned",
    "Grid",
    "PublicFile",
    "Stamp",
    "Trajectory",
    "aligned",
    "check_alike",
    "double_torsion",
    "drill_string",
    "fetch",
    "read",
    "resampled",
]
