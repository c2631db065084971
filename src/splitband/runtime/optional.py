"""Say whether torch is installed, which networks are trained with, and how to get it."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

from splitband.runtime.errors import InputError

HOW = (
    'pip install "splitband[networks]" (on Linux without a GPU, before it: '
    "pip install torch --index-url https://download.pytorch.org/whl/cpu)"
)
"""What installs torch; PyTorch documents the second line."""
LEFT_OUT = f"networks are left out, as torch is not installed: {HOW}"
"""What a comparison says that chooses its methods without torch."""


@cache
def has_torch() -> bool:
    """Return whether torch is installed; it is not imported."""
    return find_spec("torch") is not None


def require_torch(what: str = "training networks") -> None:
    """Raise ValueError, which says how to install torch, where it is missing."""
    if not has_torch():
        raise InputError(f"{what} needs torch, which is not installed: {HOW}")
