"""Define the container for measured records, readers for common file formats, public records."""

from splitband.records.alignment import Aligned, aligned, resampled
from splitband.records.public import PUBLIC, PublicFile, double_torsion, drill_string, fetch
from splitband.records.reading import read
from splitband.records.record import Record, check_alike, require_records
from splitband.records.timing import Grid, Stamp

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
