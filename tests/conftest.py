"""Fixtures that several test files share."""

import gc
import os
import pkgutil
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from multiprocessing.util import Finalize
from pathlib import Path

import pytest
from hypothesis import settings

from tests.drawing import nothing_drawn

# One core for each process of the suite. The threads of BLAS and of torch would wait for each other
# by spinning, which takes twice the time of the work itself. Tests that are about threads ask for
# them. Both are read when NumPy, SciPy and torch are loaded, by the tests.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Where Python is told to write no bytecode beside the sources, each process of the suite would
# compile all that it imports, which takes three times as long as the imports themselves.
if sys.dont_write_bytecode and sys.pycache_prefix is None:
    sys.dont_write_bytecode = False
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    # So that the processes that tests start find it, and the other workers of the suite.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix

# Some tests work in a folder of their own, from where a relative path would lead elsewhere.
if folder := os.environ.get("SPLITBAND_DATA_DIR"):
    os.environ["SPLITBAND_DATA_DIR"] = os.path.abspath(folder)

# Property tests see the same examples on every run, so that one commit has one verdict. The other
# profile is for `make fuzz`, whose --hypothesis-profile counts more than what is loaded here.
settings.register_profile("suite", derandomize=True, deadline=None, max_examples=60)
settings.register_profile("explore", deadline=None, max_examples=3000, print_blob=True)
settings.load_profile("suite")


def pytest_collection_modifyitems() -> None:
    """Import every module of the package, in each process that runs tests.

    Hypothesis also tries the constants that it finds in the modules imported so far: its examples
    would depend on which tests have run before in the same process.
    """
    for module in pkgutil.walk_packages(import_module("splitband").__path__, "splitband."):
        if not module.name.endswith("__main__"):
            import_module(module.name)


_SLAVE = '''
from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real


class VanDerPol(Fmi2Slave):
    """x'' = mu (1 - x^2) x' - x by Runge-Kutta substeps; `stop_at` and `raise_at` are in s."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.mu, self.x, self.v, self.stop_at, self.raise_at = 1.0, -2.0, 1.0, 1e9, 1e9
        self.pause = 0.0
        tunable = {"variability": Fmi2Variability.tunable, "causality": Fmi2Causality.parameter}
        for name in ("mu", "stop_at", "raise_at", "pause"):
            self.register_variable(Real(name, **tunable))
        for name in ("x", "v"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, initial=Fmi2Initial.exact)
            )

    def rate(self, x, v):
        return v, self.mu * (1 - x * x) * v - x

    def do_step(self, t, dt):
        if self.pause:
            import time
            time.sleep(self.pause)
        if t > self.raise_at:
            raise RuntimeError("no convergence")
        if t > self.stop_at:
            return False
        n = max(1, round(dt / 4e-3))
        h = dt / n
        for _ in range(n):
            a = self.rate(self.x, self.v)
            b = self.rate(self.x + h / 2 * a[0], self.v + h / 2 * a[1])
            c = self.rate(self.x + h / 2 * b[0], self.v + h / 2 * b[1])
            d = self.rate(self.x + h * c[0], self.v + h * c[1])
            self.x += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
            self.v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        return True
'''


FOREIGN = (
    "pymp-",
    "torchinductor_",
    "playwright",
    "org.chromium",
    ".org.chromium",
    "pytest-of-",
    ".ses",
)
"""What other libraries keep in the temporary folder until the process ends, or for ever."""


@pytest.fixture(autouse=True, scope="session")
def temporary_folder() -> Iterator[Path]:
    """Each process of the suite has a temporary folder, with a short name for sockets."""
    name = tempfile.mkdtemp(prefix="suite-")
    # After the folder that multiprocessing keeps in it, which goes at a priority of -100.
    Finalize(None, shutil.rmtree, (name, True), exitpriority=-1000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", name)
        patch.setattr(tempfile, "tempdir", name)
        yield Path(name)


@pytest.fixture(autouse=True, scope="module")
def nothing_left(temporary_folder: Path) -> Iterator[None]:
    """A file of tests leaves nothing in the temporary folder."""

    def found() -> list[Path]:
        return [each for each in temporary_folder.iterdir() if not each.name.startswith(FOREIGN)]

    yield
    if found():
        gc.collect()  # what belongs to an object goes with it
    left = found()
    for each in left:
        shutil.rmtree(each, ignore_errors=True)
    assert [each.name for each in left] == []


@pytest.fixture(autouse=True, scope="session")
def one_core() -> Iterator[None]:
    """Commands use one core by default, as starting a process takes longer than what is trained.

    Tests of several processes ask for them.
    """
    with pytest.MonkeyPatch.context() as patch:
        if hasattr(os, "sched_getaffinity"):
            patch.setattr(os, "sched_getaffinity", lambda _: {0})
        else:
            patch.setattr(os, "cpu_count", lambda: 1)
        yield


@pytest.fixture(autouse=True)
def this_platform_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """FMUs are compiled by the compiler of this machine, whether or not ziglang is installed."""
    monkeypatch.setitem(sys.modules, "ziglang", None)


@pytest.fixture
def drawn() -> None:
    """For tests that look at pictures or at the page."""


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results are written without pictures and pages, which take longest, unless a test looks."""
    if "drawn" not in request.fixturenames and request.path.parent.name != "report":
        nothing_drawn(monkeypatch)


@pytest.fixture
def simulated_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of what a simulator's output is used for: functions of files run in this process.

    That they run in one of their own, which takes a second to start, has tests beside it.
    """
    isolation = import_module("splitband.simulators.isolation")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(isolation.Isolated, "simulate", isolation.simulate)


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Networks begin with the same weights whatever ran before in the same process."""
    import_module("torch").default_generator.manual_seed(0)


@pytest.fixture(scope="session")
def public_data() -> Path:
    """The folder of the public records, where there is one."""
    folder = os.environ.get("SPLITBAND_DATA_DIR")
    if not folder:
        pytest.skip("SPLITBAND_DATA_DIR is not set: the public records are not at hand")
    return Path(folder)


@pytest.fixture(scope="session")
def van_der_pol_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An unforced Van der Pol oscillator as an FMU, with the outputs x and v."""
    builder = pytest.importorskip("pythonfmu.builder")
    pytest.importorskip("fmpy")
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "van_der_pol_slave.py").write_text(_SLAVE)
    return Path(builder.FmuBuilder.build_FMU(folder / "van_der_pol_slave.py", dest=folder))
