"""Identify work by a hash of all that it depends on."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np


def key_of(*parts: Any) -> str:
    """Return a hash of the parts: of arrays and tensors by content, of the others by `repr`."""
    digest = hashlib.sha256()
    for part in parts:
        is_tensor = hasattr(part, "detach")
        values = part.detach().cpu().contiguous().numpy() if is_tensor else part
        if isinstance(values, np.ndarray):
            digest.update(str((part.dtype, tuple(part.shape))).encode())
            digest.update(values.tobytes())
        else:
            digest.update(repr(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()
