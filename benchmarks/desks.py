"""Run exported FMUs as other desks do, beside the stream and `predict`: `make desks`.

    python -m benchmarks.desks [--steps 10000] [--out FILE.json]

All are written by ziglang (the extra `everywhere`). The library for Windows is loaded by a small
program under wine (of Debian: wine and wine64), that for Linux by FMPy. That for macOS is taken
apart, as nothing here can run it: its processors, its signatures, what it exports. The command
fails where something is missing, or where a difference is too large.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.simulation import instantiate_fmu
from scipy.signal import lfilter

import splitband as sb
from benchmarks import mach_o
from splitband.export.compiling import zig_cache
from splitband.export.fmu import platforms
from splitband.forecasters.network import Network
from splitband.runtime.arrays import Array
from splitband.runtime.files import write_json

LIMIT = 1e-12
TRAINED = 400
SHORT = sb.TrainingSettings.paper(window=60, warmup=20, epochs=3)
BANDS = sb.Bands(1.0, 2, 3)
MODELS: dict[str, Callable[[], sb.Forecaster]] = {
    "linear": sb.Linear,
    "GRU": lambda: sb.Single(sb.GRU(16), SHORT),
    "state-space network": lambda: sb.Single(sb.StateSpace(4, 8), SHORT),
    "split GRU, conditioned": lambda: sb.Split(
        sb.GRU(8), sb.GRU(8), BANDS, True, True, settings=SHORT
    ),
    "filtered hybrid, conditioned": lambda: sb.Filtered(
        None, sb.GRU(8), BANDS, conditioned=True, settings=SHORT
    ),
}
WINES = "wine", "wine64", "/usr/lib/wine/wine64"


def plant(samples: int) -> sb.Record:
    """Two outputs of two inputs and a simulator that is half right, with names that no port has."""
    rng = np.random.default_rng(0)
    u = np.clip(lfilter([0.3], [1.0, -0.8], rng.normal(size=(samples, 2)), axis=0), -0.8, 0.8)
    y = lfilter([0.2], [1.0, -0.9], u @ [[1.0, 0.5], [0.3, -1.0]], axis=0)
    y_sim, columns = 0.8 * y + 0.1, ("level (cm)", "flow [l/s]")
    y += 0.05 * rng.normal(size=y.shape)
    return sb.Record(y, 0.1, u=u, y_sim=y_sim, columns=columns, inputs=("valve (%)", "heat"))


def fitted(make: Callable[[], sb.Forecaster], record: sb.Record) -> sb.Forecaster:
    """A forecaster in double precision, so that nothing but rounding differs."""
    forecaster = make().fit(record[:TRAINED], seed=0)
    if isinstance(forecaster, Network) and forecaster.model is not None:
        forecaster.model.double()
    return forecaster


def streamed(forecaster: sb.Forecaster, u: Array, y_sim: Array | None) -> Array:
    """What the stream says, `(steps, ny)`."""
    stream = forecaster.stream()
    rows = [None] * len(u) if y_sim is None else [*y_sim]
    return np.stack([stream.step(each, row) for each, row in zip(u, rows, strict=True)])


def in_fmpy(folder: Path, description: Any, given: Array, shape: tuple[int, float]) -> Array:
    """What an unpacked FMU says here; `shape`: outputs, and the sampling time in s."""
    ny, step = shape
    fmu = instantiate_fmu(str(folder), description)
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    outputs, inputs = [*range(ny)], [*range(ny, ny + given.shape[1])]
    found = np.empty((len(given), ny))
    for n, row in enumerate(given):
        fmu.setReal(inputs, row.tolist())
        found[n] = fmu.getReal(outputs)
        fmu.doStep(n * step, step)
    fmu.terminate()
    fmu.freeInstance()
    return found


def on_windows(folder: Path, description: Any, given: Array, shape: tuple[int, float]) -> Array:
    """What an unpacked FMU says to a program of Windows, under wine."""
    ny, step = shape
    name = f"{description.coSimulation.modelIdentifier}.dll"
    words = [name, description.guid, ny, given.shape[1], repr(step), len(given)]
    rows = "\n".join(" ".join(map(repr, row)) for row in given.tolist())
    quiet = {"WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    command = [wine(), "desks.exe", *map(str, words)]
    at: Any = {"input": rows, "env": os.environ | quiet, "cwd": folder / "binaries/win64"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, **at)
    if done.returncode:
        raise SystemExit(f"the program failed under wine: {done.stderr[-500:]}")
    return np.array([line.split() for line in done.stdout.splitlines()], dtype=float)


def wine() -> str:
    """The command that runs programs of Windows."""
    for word in WINES:
        if found := shutil.which(word):
            return found
    raise SystemExit("wine is not there: apt-get install --no-install-recommends wine wine64")


def program(folder: Path) -> None:
    """Compile the program that loads a library on Windows, in a folder."""
    source = Path(__file__).with_suffix(".c")
    headers = Path(fmpy.__file__).parent / "c-code"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O2"]
    caches = {"ZIG_GLOBAL_CACHE_DIR": str(zig_cache()), "ZIG_LOCAL_CACHE_DIR": str(folder / "zig")}
    command += ["-I", str(headers), "-o", str(folder / "desks.exe"), str(source)]
    subprocess.run(command, env=os.environ | caches, check=True)


def binaries(folder: Path, name: str) -> dict[str, Any]:
    """What the three libraries of an FMU need, and what is in them."""
    library = {
        each: (folder / "binaries" / each / f"{name}{ending}").read_bytes()
        for each, ending in (("win64", ".dll"), ("linux64", ".so"), ("darwin64", ".dylib"))
    }
    needs = {each.decode() for each in re.findall(rb"[\w.-]+\.dll", library["win64"])}
    asked = re.findall(rb"GLIBC_(\d+)\.(\d+)", library["linux64"])
    newest = max((int(a), int(b)) for a, b in asked)
    source = (folder / "sources/fmu.c").read_text(encoding="ascii")
    functions = {*re.findall(r"^(?!static)\w.*?\b(fmi2\w+)\(", source, re.MULTILINE)}
    parts = {
        processor: {
            "oldest macOS": part.macos,
            "signed": part.signed,
            "functions missing": sorted(functions - part.names),
            "functions": len(functions & part.names),
        }
        for processor, part in mach_o.parts(library["darwin64"]).items()
    }
    return {
        "win64": {"bytes": len(library["win64"]), "needs": sorted(needs - {f"{name}.dll"})},
        "linux64": {"bytes": len(library["linux64"]), "glibc": ".".join(map(str, newest))},
        "darwin64": {"bytes": len(library["darwin64"]), "parts": parts},
    }


def wrong(facts: Mapping[str, Any]) -> bool:
    """Whether what was found of a method is not as promised."""
    off, parts = facts["difference from the stream"], facts["binaries"]["darwin64"]["parts"]
    return not (
        max(off["win64"], off["linux64"]) <= LIMIT
        and facts["written twice, equal"]
        and {*parts} == {"x86_64", "arm64"}
        and parts["arm64"]["signed"]
        and not any(part["functions missing"] or not part["functions"] for part in parts.values())
    )


def compared(name: str, folder: Path, steps: int) -> dict[str, Any]:
    """The largest differences of one method, as shares of the signal's deviation."""
    record = plant(TRAINED + steps)
    forecaster, ahead = fitted(MODELS[name], record), record[TRAINED:]
    assert ahead.u is not None
    assert ahead.y_sim is not None
    began = time.perf_counter()
    (file,) = forecaster.export(folder / "rig.fmu")
    seconds, before = time.perf_counter() - began, file.read_bytes()
    forecaster.export(file)
    description = fmpy.read_model_description(str(file))
    fmpy.extract(str(file), str(folder / "rig"))
    real = [v for v in description.modelVariables if v.type == "Real" and v.causality == "input"]
    driven = sum(not v.name.endswith("_measured") for v in real)
    given = np.hstack([ahead.u, ahead.y_sim])[:, :driven]
    hybrid = driven > ahead.u.shape[1]
    wanted = streamed(forecaster, ahead.u, ahead.y_sim if hybrid else None)
    shutil.copy(folder.parent / "desks.exe", folder / "rig/binaries/win64")
    shape = (record.ny, record.sampling_time)
    found = {
        "win64": on_windows(folder / "rig", description, given, shape),
        "linux64": in_fmpy(folder / "rig", description, given, shape),
        "predict": forecaster.predict(steps, y_sim=ahead.y_sim if hybrid else None, u=ahead.u).y,
    }
    scale = float(np.std(record.y))
    return {
        "difference from the stream": {
            each: float(np.abs(said - wanted).max()) / scale for each, said in found.items()
        },
        "binaries": binaries(folder / "rig", "rig"),
        "platforms": platforms(file),
        "written twice, equal": before == file.read_bytes(),
        "seconds": seconds,
        "bytes": len(before),
    }


def main() -> None:
    """Compare, print, and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as made:  # wine's server lingers
        os.environ["WINEPREFIX"] = str(Path(made) / "wine")
        said = subprocess.run([wine(), "--version"], capture_output=True, text=True, check=True)
        program(Path(made))
        found = {}
        for name in MODELS:
            folder = Path(made) / re.sub(r"\W+", "-", name)
            folder.mkdir()
            found[name] = compared(name, folder, arguments.steps)
            print(f"{name}: {found[name]}", flush=True)
    most = {
        each: max(facts["difference from the stream"][each] for facts in found.values())
        for each in ("win64", "linux64", "predict")
    }
    print(f"largest differences over {arguments.steps} steps: {most}")
    if arguments.out:
        versions = {"ziglang": version("ziglang"), "wine": said.stdout.strip()}
        write_json(
            arguments.out,
            {"steps": arguments.steps, "versions": versions, "most": most, "models": found},
        )
    if bad := [name for name, facts in found.items() if wrong(facts)]:
        raise SystemExit(f"not as promised: {', '.join(bad)}")


if __name__ == "__main__":
    main()
