"""Measured records: the data container, readers for the usual files, and the public records."""

from splitband.data.public import PUBLIC, PublicFile, double_torsion, drill_string, fetch
from splitband.data.reading import read
from splitband.data.trajectory import Trajectory

__all__ = ["PUBLIC", "PublicFile", "Trajectory", "double_torsion", "drill_string", "fetch", "read"]
