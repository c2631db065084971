"""Define the container for measured records, readers for common file formats, public records."""

from splitband.data.alignment import Aligned, aligned, resampled
from splitband.data.public import PUBLIC, PublicFile, double_torsion, drill_string, fetch
from splitband.data.reading import read
from splitband.data.record import Record, check_alike, require_records
from splitband.data.timing import Grid, Stamp

__all__ = [
    "PUBLIC",
    "Aligned",
    "Grid",
    "PublicFile",
    "Record",
    "Stamp",
    "aligned",
    "check_alike",
    "double_torsion",
    "drill_string",
    "fetch",
    "read",
    "require_records",
    "resampled",
]
