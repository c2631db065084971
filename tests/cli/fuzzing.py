"""Inputs that nobody would think of, for the file readers, the model loader and the command line.

    python -m tests.cli.fuzzing [--inputs 12000] [--seed N] [--out docs/benchmarks/fuzz.json]

Each target makes inputs, mostly sound ones that were damaged somewhere, and checks what comes of
them: a result or an error that says what is wrong, soon, and no file beside the output touched.
`test_fuzz.py` runs a few of them.
"""

from __future__ import annotations

import argparse
import copy
import hashlib
import io
import json
import platform
import random
import shlex
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
from unittest.mock import patch

import numpy as np
import pandas as pd
import scipy.io
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import splitband as sb
from splitband import GRU, read
from splitband.cli import main
from splitband.forecasters import saving
from splitband.runtime.files import write_json
from tests.cli.support import files

PATIENCE = 60
"""Seconds after which an input is taken for one that hangs."""
SHARES = {"readers": 5 / 9, "models": 2 / 9, "command_line": 2 / 9}
"""Of the inputs."""

outcomes: dict[str, Counter[str]] = {name: Counter() for name in SHARES}
"""By target: how many inputs had a result, and how many an error."""

Result = TypeVar("Result")
Edit = tuple[str, float, bytes]
_NO_EDITS: list[Edit] = []
_EDITS = st.just(_NO_EDITS) | st.lists(
    st.tuples(
        st.sampled_from(("replace", "insert", "cut", "repeat", "end")),
        st.floats(0, 1),
        st.binary(min_size=1, max_size=12)
        | st.sampled_from((b"nan", b"1e400", b"\n", b",", b"\0")),
    ),
    max_size=4,
)


def edited(content: bytes, edits: list[Edit]) -> bytes:
    """`content` with pieces replaced, inserted, cut out or repeated."""
    for kind, share, piece in edits:
        at = int(share * len(content))
        after = at if kind in ("insert", "repeat") else at + len(piece)
        put = {"repeat": content[at : at + 40], "cut": b""}.get(kind, piece)
        content = content[:at] if kind == "end" else content[:at] + put + content[after:]
    return content


class Hanging(BaseException):
    """What nothing catches."""


@contextmanager
def watched() -> Iterator[None]:
    """End what does not come to an end."""

    def stop(*_: object) -> None:
        raise Hanging(f"no end after {PATIENCE} s")

    previous = signal.signal(signal.SIGALRM, stop)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


def _or_error(call: Callable[[], Result]) -> tuple[Result | None, str]:
    """What is returned, or what a ValueError says."""
    try:
        return call(), ""
    except ValueError as error:
        return None, str(error)


@cache
def records() -> dict[str, bytes]:
    """A sound file of each kind, by its suffix."""
    t = 0.1 * np.arange(60)
    table = pd.DataFrame({"time": t, "a": np.sin(t), "b": np.round(np.cos(2 * t), 3)})
    dated = table.assign(time=pd.date_range("2026-01-01", periods=60, freq="100ms"))
    files: dict[str, bytes] = {}
    for suffix, content in (
        ("csv", table.to_csv(index=False)),
        ("tsv", table.to_csv(index=False, sep="\t")),
        ("txt", table.to_string(index=False)),
        ("dates.csv", dated.to_csv(index=False)),
        ("decimal.csv", table.to_csv(index=False, sep=";", decimal=",")),
    ):
        files[suffix] = content.encode()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arrays: dict[str, Any] = {"y": table[["a", "b"]].to_numpy(), "dt": 0.1}
        table.to_parquet(folder / "r.parquet")
        np.savez_compressed(folder / "r.npz", **arrays)
        np.save(folder / "r.npy", arrays["y"])
        scipy.io.savemat(folder / "r.mat", arrays, do_compression=True)
        for path in folder.iterdir():
            files[path.suffix[1:]] = path.read_bytes()
    return files


_CELLS = st.sampled_from(
    ("", "nan", "inf", "1", "-2.5e3", "1e999", "x", '"', "1,5", "#", "é", "\0")
)
_TABLES = st.builds(
    lambda rows, sep, end: end.join(sep.join(row) for row in rows).encode(),
    st.lists(st.lists(_CELLS, max_size=4), max_size=12),
    st.sampled_from((",", ";", "\t", " ", "|")),
    st.sampled_from(("\n", "\r\n", "\r")),
)
_OPTIONS = st.just({"fallback_sampling_time": 0.1}) | st.fixed_dictionaries(
    {"fallback_sampling_time": st.just(0.1), "gaps": st.sampled_from(("refuse", "mask"))},
    optional={
        "columns": st.sampled_from(("a", ["a", "b"], ["y[0]"], "absent", [], [0])),
        "inputs": st.sampled_from(("b", ["a"], [1], "y[1]")),
        "time_column": st.sampled_from(("time", "", "b", 0)),
        "sampling_time": st.sampled_from((0.1, 0.0, -1.0, float("nan"), 1e-300)),
    },
)


@given(st.data(), _EDITS, st.none() | st.none() | _TABLES, _OPTIONS)
def readers(data: st.DataObject, edits: list[Edit], text: bytes | None, options: Any) -> None:
    """A file is a record of finite numbers, or a ValueError names it."""
    suffix = data.draw(st.sampled_from(sorted(records())))
    binary = suffix in ("parquet", "npz", "npy", "mat")
    content = records()[suffix] if text is None or binary else text
    with tempfile.TemporaryDirectory() as name, watched():
        path = Path(name) / f"record.{suffix}"
        path.write_bytes(edited(content, edits))
        found, said = _or_error(lambda: read(path, **options))
        named = str(path) in said and "\n" not in said
    outcomes["readers"]["refused" if found is None else "read"] += 1
    if found is None:
        assert named, said
        return
    assert len(found) >= 2
    assert np.isfinite(found.y).all()


@cache
def model_files() -> dict[str, bytes]:
    """Those of a sound model."""
    with tempfile.TemporaryDirectory() as name:
        saving.save(_small_model(), name, _facts())
        return {path.name: path.read_bytes() for path in Path(name).iterdir()}


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 10**12) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=4,
) | st.sampled_from(
    (
        {"kind": "GRU", "options": {"ny": 1, "hidden_size": 10**6, "nu": 0}},
        {"kind": "system", "module": "os", "options": {}},
    )
)


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every place in a JSON value that can be overwritten."""
    keys = [*value] if isinstance(value, dict) else range(len(value))
    here = [(value, key) for key in keys]
    inner = [value[key] for key in keys if isinstance(value[key], dict | list)]
    return here + [place for part in inner for place in _places(part)]


@given(st.data(), st.lists(_VALUES, max_size=2), _EDITS, st.booleans())
def models(data: st.DataObject, values: list[Any], edits: list[Edit], resealed: bool) -> None:
    """A model folder is a model, or a ValueError says what is wrong with it."""
    files = dict(model_files())
    if edits:
        name = data.draw(st.sampled_from(sorted(files)))
        files[name] = edited(files[name], edits)
    try:
        description = json.loads(files["forecaster.json"])
    except (ValueError, RecursionError):
        description = None
    if isinstance(description, dict):
        for value in values:
            inside, key = data.draw(st.sampled_from(_places(description)))
            inside[key] = copy.deepcopy(value)
            if not description:
                break
        if resealed:
            (weights,) = (name for name in files if name.startswith("weights-"))
            digest = hashlib.sha256(files[weights]).hexdigest()
            description["weights_sha256"] = digest
            files[saving.WEIGHTS.format(digest[:16])] = files.pop(weights)
        if values or resealed:
            files["forecaster.json"] = json.dumps(description).encode()
    with tempfile.TemporaryDirectory() as name, watched():
        for file, content in files.items():
            (Path(name) / file).write_bytes(content)
        found, said = _or_error(lambda: sb.load(name))
        named = name in said
    outcomes["models"]["refused" if found is None else "loaded"] += 1
    if found is None:
        assert named, said
        return
    model = getattr(found, "model", None)
    assert model is None or sum(p.numel() for p in model.parameters()) < 1000


_NUMBERS = ("0", "1", "2", "7", "30", "45", "60", "-1", "1e9", "nan", "x", "", "0.5", "5")
_COMMANDS = (
    "inspect {record} --out out",
    "fit {record} --out out --method gru --epochs 1 --hidden 2,2 --window 12 --warmup 4",
    "compare {record} --out out --methods persistence,mean --seeds 1 --jobs 1 --warmup 4",
    "simulate model --history {record} --steps 3 --out out/ahead.csv",
    "export model out/model.c",
    "forecast {record} --out out --steps 4 --method persistence --jobs 1",
    "data",
    "{record}",
    "",
)
_FLAGS = """
    --train --warmup --window --epochs --cutoff --order --downsampling --sampling-time --steps
    --seeds --horizon --hidden --columns --inputs --time-column --gaps --methods
    --method --more --simulator --simulator-timeout --recipe --history --learning-rate --seed
    --like --nonsense"""
_NAMES = """
    a b time mask refuse auto default gru split-gru simulator record.csv record.npz model
    absent.csv 3,2 1:2 mean ."""
_OPTIONS_GIVEN = st.tuples(
    st.sampled_from(_FLAGS.split()), st.sampled_from([*_NUMBERS, *_NAMES.split()])
)


@given(
    st.sampled_from(_COMMANDS),
    st.sampled_from(("csv", "npz", "parquet", "mat", "dates.csv")),
    _EDITS,
    st.lists(_OPTIONS_GIVEN, max_size=3),
    st.booleans(),
)
def command_line(
    command: str, suffix: str, edits: list[Edit], options: list[tuple[str, str]], damaged: bool
) -> None:
    """A command ends well, or with status 2 and one line; what is beside --out is as before."""
    with tempfile.TemporaryDirectory() as name, watched():
        folder = Path(name)
        for kind, content in records().items():
            (folder / f"record.{kind}").write_bytes(content)
        saved = folder / "model"
        saving.save(_small_model(), saved, _facts())
        if damaged:
            broken = folder / f"record.{suffix}"
            broken.write_bytes(edited(broken.read_bytes(), edits))
        words = shlex.split(command.format(record=f"record.{suffix}"))
        words += [word for option in options for word in option]
        before = files(folder)
        said, complained = io.StringIO(), io.StringIO()
        quick = patch("splitband.comparison.plan.BUDGET", 5.0)
        with chdir(folder), quick, redirect_stdout(said), redirect_stderr(complained):
            status = main(words)
        after = {k: v for k, v in files(folder).items() if k.split("/")[0] != "out"}
    assert status in (0, 2), words
    assert after == before, words
    lines = [line for line in complained.getvalue().splitlines() if line.startswith("error: ")]
    assert len(lines) == (status == 2), words
    assert "Traceback" not in complained.getvalue() + said.getvalue(), words
    outcomes["command_line"]["refused" if status else "done"] += 1


@cache
def _small_model() -> sb.Forecaster:
    record = sb.Record(np.sin(0.3 * np.arange(60)), 0.1, columns=("a",))
    bands, short = sb.Bands(1.0, 1, 2), sb.TrainingSettings.paper(window=20, warmup=8, epochs=1)
    return sb.Split(GRU(2), GRU(3), bands, conditioned=True, settings=short).fit(record)


def _facts() -> dict[str, Any]:
    facts = {"method": "gru", "columns": ["a"], "inputs": [], "sampling_time": 0.1}
    setup = {"settings": {"warmup": 5}}
    return facts | {"setup": setup, "calibration": None, "range": [[-1.0], [1.0]]}


TARGETS: dict[str, Callable[[], None]] = {
    "readers": readers,
    "models": models,
    "command_line": command_line,
}


def run(target: str, inputs: int, number: int = 0) -> None:
    """Run a target on so many inputs."""
    few = settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        suppress_health_check=[*HealthCheck],
        phases=[Phase.generate, Phase.shrink],
    )
    seed(number)(few(TARGETS[target]))()


def _run_all() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--inputs", type=int, default=12_000)
    parser.add_argument("--seed", type=int, help="as printed by an earlier run; random if left out")
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/fuzz.json"))
    arguments = parser.parse_args()
    number = random.randrange(2**32) if arguments.seed is None else arguments.seed
    print(f"seed {number}", flush=True)
    found: dict[str, Any] = {}
    for target, share in SHARES.items():
        began = time.perf_counter()
        run(target, round(share * arguments.inputs), number)
        seconds = time.perf_counter() - began
        found[target] = {"inputs": outcomes[target].total(), **outcomes[target], "seconds": seconds}
        print(target, found[target], flush=True)
    total = sum(facts["inputs"] for facts in found.values())
    print(f"{total} inputs, none with a traceback, a hang or a file touched beside its output")
    machine = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    write_json(
        arguments.out, {"inputs": total, "seed": number, "targets": found, "machine": machine}
    )


if __name__ == "__main__":
    _run_all()
