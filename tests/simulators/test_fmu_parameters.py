"""The parameters of an FMU that is compiled here from C: fitted, gone on with, side by side."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.simulators import Effort, identify

pytest.importorskip("fmpy")
if shutil.which("gcc") is None or sys.platform != "linux":
    pytest.skip("no gcc to compile an FMU with", allow_module_level=True)

CODE = r"""
#include <stdlib.h>
#define STUB(name) int name(void) { return 3; }
STUB(fmi2CancelStep) STUB(fmi2GetInteger) STUB(fmi2GetBoolean) STUB(fmi2GetString)
STUB(fmi2SetInteger) STUB(fmi2SetBoolean) STUB(fmi2SetString) STUB(fmi2GetFMUstate)
STUB(fmi2SetFMUstate) STUB(fmi2FreeFMUstate) STUB(fmi2SerializedFMUstateSize)
STUB(fmi2SerializeFMUstate) STUB(fmi2DeSerializeFMUstate) STUB(fmi2GetDirectionalDerivative)
STUB(fmi2SetRealInputDerivatives) STUB(fmi2GetRealOutputDerivatives) STUB(fmi2GetStatus)
STUB(fmi2GetRealStatus) STUB(fmi2GetIntegerStatus) STUB(fmi2GetBooleanStatus)
STUB(fmi2GetStringStatus)
typedef struct { double r[6]; } Model;  /* x, v, k, c, force, crashes */
static void begin(Model *m)
{ double r[6] = {1, 0, 1, 0.1, 0, 0}; for (int i = 0; i < 6; i++) m->r[i] = r[i]; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const s[]) { return 0; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *l, const void *f, int v,
                      int d)
{ Model *m = malloc(sizeof *m); begin(m); return m; }
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int a, double b, double t, int d, double e) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { return 0; }
int fmi2Terminate(void *c) { return 0; }
int fmi2Reset(void *c) { begin(c); return 0; }
int fmi2SetReal(void *c, const unsigned v[], size_t n, const double x[])
{ for (size_t i = 0; i < n; i++) ((Model *)c)->r[v[i]] = x[i]; return 0; }
int fmi2GetReal(void *c, const unsigned v[], size_t n, double x[])
{ for (size_t i = 0; i < n; i++) x[i] = ((Model *)c)->r[v[i]]; return 0; }
int fmi2DoStep(void *c, double t, double h, int p)
{
    double *r = ((Model *)c)->r;
    if (r[5] > 0.5 && r[2] > 12) abort();
    for (int i = 0; i < 100; i++) {
        r[1] += h / 100 * (r[4] - r[2] * r[0] - r[3] * r[1]);
        r[0] += h / 100 * r[1];
    }
    return 0;
}
"""
VARIABLES = "\n".join(
    f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}" '
    f'variability="{variability}"{initial}><Real{start}/></ScalarVariable>'
    for i, (name, causality, variability, initial, start) in enumerate([
        ("x", "output", "continuous", ' initial="exact"', ' start="1"'),
        ("v", "local", "continuous", ' initial="exact"', ' start="0"'),
        ("k", "parameter", "fixed", ' initial="exact"', ' start="1"'),
        ("c", "parameter", "fixed", ' initial="exact"', ' start="0.1"'),
        ("force", "input", "continuous", "", ' start="0"'),
        ("crashes", "parameter", "fixed", ' initial="exact"', ' start="0"'),
    ])
)  # fmt: skip
DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Rig" guid="rig">
<CoSimulation modelIdentifier="rig" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{VARIABLES}</ModelVariables>
<ModelStructure><Outputs><Unknown index="1"/></Outputs></ModelStructure>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    (folder / "rig.c").write_text(CODE)
    library = folder / "rig.so"
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", folder / "rig.c", "-o", library], check=True)
    with zipfile.ZipFile(folder / "rig.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
        archive.write(library, "binaries/linux64/rig.so")
    return folder / "rig.fmu"


def measured(samples: int = 150) -> sb.Record:
    """By SciPy: k = 4, c = 0.3."""
    random = np.random.default_rng(0)
    u = np.repeat(random.choice([-2.0, 2.0], samples // 10), 10)
    system = [[0.0, 1.0], [-4.0, -0.3]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
    _, y, _ = scipy.signal.lsim(system, u, 0.1 * np.arange(samples), X0=[1.0, 0.0],
                                 interp=False)  # fmt: skip
    return sb.Record(y + random.normal(0, 0.01, samples), 0.1, u=u)


def test_two_parameters_are_found_and_what_was_stopped_goes_on(rig: Path, tmp_path: Path) -> None:
    fmu = sb.Fmu(rig, parameters={"k": (0.4, 40.0), "c": (0.0, 2.0)})
    done: list[int] = []

    def stop(count: int, _: int) -> None:
        done.append(count)
        if count == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        identify(fmu, measured(), effort=Effort(6, folder=tmp_path, progress=stop))
    assert done == [1, 2, 3]
    found = identify(fmu, measured(), effort=Effort(
        6, folder=tmp_path, progress=lambda count, _: done.append(count)))  # fmt: skip
    assert done[3] == 4
    assert found.values == pytest.approx({"k": 4.0, "c": 0.3}, rel=0.01)


def test_of_starts_side_by_side_one_whose_simulator_ends_its_process_has_failed(rig: Path) -> None:
    """At k above 12."""
    fmu = sb.Fmu(rig, parameters={"k": (0.5, 50.0), "c": 0.3, "crashes": 1.0})
    found = identify(fmu, measured(60), effort=Effort(3, workers=2))
    assert found.values == pytest.approx({"k": 4.0}, rel=0.02)
    assert found.starts[1] < 3


def test_it_forecasts_with_inputs(rig: Path) -> None:
    record = measured()
    model = sb.GreyBox(sb.Fmu(rig, parameters={"k": (3.0, 5.0), "c": 0.3}), starts=1)
    found = model.fit(record[:100]).predict(50, record[:100])
    assert sb.nrmse(record.y[100:], found.y) < 0.05
