"""The package's front door."""

from __future__ import annotations

import subprocess
import sys

import pytest

import splitband


def test_every_public_name_is_there() -> None:
    assert all(getattr(splitband, name).__name__ == name for name in splitband.__all__)
    assert set(splitband.__all__) <= set(dir(splitband))
    assert {name for names in splitband._MODULES.values() for name in names} == set(
        splitband.__all__
    )


def test_other_names_are_not() -> None:
    with pytest.raises(AttributeError, match="no attribute 'split'"):
        splitband.split  # noqa: B018


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = """
import sys, splitband
heavy = {"torch", "numba", "pandas", "scipy", "matplotlib"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
from splitband import rollout
import splitband.models
assert callable(splitband.rollout)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
