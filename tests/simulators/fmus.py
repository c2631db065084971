"""Functional mock-up units that are compiled from C, for FMI 2 and 3 and both kinds."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

COMPILES = shutil.which("gcc") is not None and sys.platform == "linux"

COMMON = r"""
#include <stdlib.h>
#include <string.h>
#include <math.h>
#define STUB(name) int name(void) { return 3; }
enum { U, V, X, Y, K, N };  /* two inputs, a state, an output, a parameter */
typedef struct { double r[N], shown, t, next; int flag, exchange, stale; } Model;
static void begin(Model *m) { memset(m, 0, sizeof *m); m->r[K] = 1; m->next = NEXT; }
static double slope(Model *m) { double *r = m->r; return SLOPE; }
static double out(Model *m) { double *r = m->r; return OUT; }
static int set(Model *m, const unsigned v[], size_t n, const double x[])
{ for (size_t i = 0; i < n; i++) m->r[v[i]] = x[i]; m->stale = 1; return 0; }
static int get(Model *m, const unsigned v[], size_t n, double x[])
{
    if (MODE == 2 && m->stale && !m->exchange) return 3;  /* refuses to be read after a set */
    for (size_t i = 0; i < n; i++)
        x[i] = v[i] == Y ? (MODE == 0 || m->exchange ? out(m) : m->shown) : m->r[v[i]];
    return 0;
}
static int step(Model *m, double h)
{
    if (FIXED && fabs(h - FIXED) > 1e-9) return 3;
    if (SUBSTEPS == 0) m->r[X] += h * slope(m);
    for (int i = 0; i < SUBSTEPS; i++) {  /* the midpoint rule */
        double x = m->r[X];
        m->r[X] = x + h / SUBSTEPS / 2 * slope(m);
        m->r[X] = x + h / SUBSTEPS * slope(m);
    }
    m->shown = out(m);
    m->stale = 0;
    return 0;
}
"""

FMI2 = r"""
STUB(fmi2CancelStep) STUB(fmi2GetString) STUB(fmi2SetString) STUB(fmi2GetFMUstate)
STUB(fmi2SetFMUstate) STUB(fmi2FreeFMUstate) STUB(fmi2SerializedFMUstateSize)
STUB(fmi2SerializeFMUstate) STUB(fmi2DeSerializeFMUstate) STUB(fmi2GetDirectionalDerivative)
STUB(fmi2SetRealInputDerivatives) STUB(fmi2GetRealOutputDerivatives) STUB(fmi2GetStatus)
STUB(fmi2GetRealStatus) STUB(fmi2GetIntegerStatus) STUB(fmi2GetBooleanStatus)
STUB(fmi2GetStringStatus)
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const s[]) { return 0; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *l, const void *f, int v,
                      int d)
{ Model *m = malloc(sizeof *m); begin(m); m->exchange = t == 0; return m; }
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(Model *m, int a, double b, double t, int d, double e)
{ m->t = t; m->next += t; return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(Model *m) { m->shown = out(m); m->stale = 0; return 0; }
int fmi2Terminate(void *c) { return 0; }
int fmi2Reset(Model *m) { int kind = m->exchange; begin(m); m->exchange = kind; return 0; }
int fmi2SetReal(void *c, const unsigned v[], size_t n, const double x[]) { return set(c, v, n, x); }
int fmi2GetReal(void *c, const unsigned v[], size_t n, double x[]) { return get(c, v, n, x); }
static int whole(void *c, const unsigned v[], size_t n, const int x[])
{ double r; for (size_t i = 0; i < n; i++) { r = x[i]; set(c, v + i, 1, &r); } return 0; }
int fmi2SetInteger(void *c, const unsigned v[], size_t n, const int x[])
{ return whole(c, v, n, x); }
int fmi2SetBoolean(void *c, const unsigned v[], size_t n, const int x[])
{ return whole(c, v, n, x); }
int fmi2GetInteger(Model *m, const unsigned v[], size_t n, int x[])
{ for (size_t i = 0; i < n; i++) x[i] = m->r[v[i]]; return 0; }
int fmi2GetBoolean(Model *m, const unsigned v[], size_t n, int x[])
{ return fmi2GetInteger(m, v, n, x); }
int fmi2DoStep(void *c, double t, double h, int p) { return step(c, h); }
/* for model exchange */
typedef struct { int more, ended, nominals, values, defined; double time; } Info;
int fmi2EnterEventMode(void *c) { return 0; }
int fmi2NewDiscreteStates(Model *m, Info *info)
{
    double *r = m->r;
    memset(info, 0, sizeof *info);
    if (m->next <= m->t + 1e-12) { r[X] += 1; m->next = 1e300; info->values = 1; }
    if (EXCEEDED) m->flag = 1;
    if (LIMIT < 1e9) r[V] = m->flag;
    info->defined = m->next < 1e299;
    info->time = m->next;
    return 0;
}
int fmi2EnterContinuousTimeMode(void *c) { return 0; }
int fmi2CompletedIntegratorStep(void *c, int a, int *event, int *ended)
{ *event = *ended = 0; return 0; }
int fmi2SetTime(Model *m, double t) { m->t = t; return 0; }
int fmi2SetContinuousStates(Model *m, const double x[], size_t n) { m->r[X] = x[0]; return 0; }
int fmi2GetDerivatives(Model *m, double x[], size_t n) { x[0] = slope(m); return 0; }
int fmi2GetEventIndicators(Model *m, double z[], size_t n) { z[0] = m->r[X] - LIMIT; return 0; }
int fmi2GetContinuousStates(Model *m, double x[], size_t n) { x[0] = m->r[X]; return 0; }
int fmi2GetNominalsOfContinuousStates(void *c, double x[], size_t n) { x[0] = 1; return 0; }
"""

FMI3 = r"""
#include <stdbool.h>
const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(void) { Model *m = malloc(sizeof *m); begin(m); return m; }
void *fmi3InstantiateModelExchange(void) { Model *m = malloc(sizeof *m); begin(m); return m; }
void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterInitializationMode(Model *m, bool a, double b, double t, bool d, double e)
{ m->t = t; return 0; }
int fmi3ExitInitializationMode(Model *m) { m->shown = out(m); m->stale = 0; return 0; }
int fmi3Terminate(void *c) { return 0; }
int fmi3Reset(void *c) { begin(c); return 0; }
int fmi3SetFloat64(void *c, const unsigned v[], size_t n, const double x[], size_t k)
{ return set(c, v, n, x); }
int fmi3GetFloat64(void *c, const unsigned v[], size_t n, double x[], size_t k)
{ return get(c, v, n, x); }
int fmi3DoStep(Model *m, double t, double h, bool a, bool *event, bool *ended, bool *early,
               double *at)
{ *event = *ended = *early = 0; *at = t + h; return step(m, h); }
int fmi3EnterEventMode(void *c) { return 0; }
int fmi3EnterContinuousTimeMode(void *c) { return 0; }
int fmi3UpdateDiscreteStates(void *c, bool *a, bool *b, bool *d, bool *e, bool *f, double *t)
{ *a = *b = *d = *e = *f = 0; return 0; }
int fmi3CompletedIntegratorStep(void *c, bool a, bool *event, bool *ended)
{ *event = *ended = 0; return 0; }
int fmi3SetTime(Model *m, double t) { m->t = t; return 0; }
int fmi3SetContinuousStates(Model *m, const double x[], size_t n) { m->r[X] = x[0]; return 0; }
int fmi3GetContinuousStateDerivatives(Model *m, double x[], size_t n) { x[0] = slope(m); return 0; }
int fmi3GetEventIndicators(Model *m, double z[], size_t n) { return 0; }
int fmi3GetContinuousStates(Model *m, double x[], size_t n) { x[0] = m->r[X]; return 0; }
int fmi3GetNominalsOfContinuousStates(void *c, double x[], size_t n) { x[0] = 1; return 0; }
"""


def built(
    path: Path,
    kinds: Sequence[str] = ("CoSimulation",),
    *,
    version: int = 2,
    slope: str = "r[U] - r[X]",
    out: str = "r[X]",
    mode: int = 0,
    fixed: float = 0.0,
    types: Sequence[str] = ("Real", "Real"),
    inputs: Sequence[str] = ("u",),
    output: str = "y",
    dependencies: str | None = None,
    declared: float = 0.0,
    next_event: float = 1e300,
    limit: float = 1e300,
    exceeded: str = "r[X] > LIMIT - 1e-9",
    substeps: int = 200,
) -> Path:
    """Compile x' = `slope`, y = `out` of the inputs r[U] and r[V] as an FMU; return its path.

    Parameters
    ----------
    mode : How co-simulation shows y: 0 at once, 1 after a step, 2 refused between set and step.
    fixed : The only step that is taken.
    declared : Step of its default experiment, or fixed internal step for FMI 3.
    inputs, types, output : Names and types of the variables.
    dependencies : Of y, as the description gives them.
    next_event : Time at which x jumps by 1, in model exchange.
    limit : State above which r[V] becomes 1 for good, in model exchange.
    exceeded : The condition for it.
    substeps : Steps of the midpoint rule in a communication step; with 0 it is one of Euler.
    """
    defines = {"SLOPE": slope, "OUT": out, "MODE": mode, "FIXED": fixed, "NEXT": next_event}
    defines |= {"LIMIT": limit, "EXCEEDED": exceeded, "SUBSTEPS": substeps}
    source = "\n".join(f"#define {name} ({value})" for name, value in defines.items()) + COMMON
    source += FMI2 if version == 2 else FMI3
    if version == 3:
        missing = (name for name in _of_fmi3() if not re.search(rf"[ *]{name}\(", source))
        source += "".join(f"STUB({name})\n" for name in missing)
    code = path.with_suffix(".c")
    code.write_text(source)
    library = path.with_suffix(".so")
    subprocess.run(["gcc", "-O1", "-w", "-shared", "-fPIC", code, "-o", library, "-lm"], check=True)
    if version == 2:
        indicated = limit < 1e9
        text = _second(path.stem, kinds, inputs, types, output, dependencies, fixed, indicated)
    else:
        text = _third(path.stem, kinds, inputs)
    if declared and version == 3:
        own = f'<CoSimulation fixedInternalStepSize="{declared}" '
        text = text.replace("<CoSimulation ", own)
    elif declared:
        own = f'<DefaultExperiment stepSize="{declared}"/><ModelVariables>'
        text = text.replace("<ModelVariables>", own)
    folder = "x86_64-linux" if version == 3 else "linux64"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{folder}/{path.stem}.so")
    return path


def _of_fmi3() -> list[str]:
    import fmpy.fmi3  # noqa: PLC0415  the optional extra

    said = Path(fmpy.fmi3.__file__).read_text()
    return sorted({*re.findall(r"def (fmi3[A-Z]\w+)", said)})


def _second(
    name: str,
    kinds: Sequence[str],
    inputs: Sequence[str],
    types: Sequence[str],
    output: str,
    dependencies: str | None,
    fixed: float,
    indicated: bool,
) -> str:
    variables = [
        f'<ScalarVariable name="{each}" valueReference="{i}" causality="input" variability='
        f'"{"continuous" if kind == "Real" else "discrete"}"><{kind} start="{start}"/>'
        "</ScalarVariable>"
        for i, (each, kind) in enumerate(zip(inputs, types, strict=False))
        for start in ["false" if kind == "Boolean" else "0"]
    ]
    first = len(variables) + 1
    variables += [
        '<ScalarVariable name="x" valueReference="2" causality="local" variability="continuous" '
        'initial="exact"><Real start="0"/></ScalarVariable>',
        f'<ScalarVariable name="der(x)" valueReference="9" causality="local"><Real derivative='
        f'"{first}"/></ScalarVariable>',
        f'<ScalarVariable name="{output}" valueReference="3" causality="output"><Real/>'
        "</ScalarVariable>",
        '<ScalarVariable name="k" valueReference="4" causality="parameter" variability="tunable" '
        'initial="exact"><Real start="1"/></ScalarVariable>',
    ]
    can = "false" if fixed else "true"
    how = {
        "CoSimulation": f'canHandleVariableCommunicationStepSize="{can}"',
        "ModelExchange": 'completedIntegratorStepNotNeeded="false"',
    }
    said = "" if dependencies is None else f' dependencies="{dependencies}"'
    ordered = sorted(kinds, reverse=True)
    kind = "".join(f'<{each} modelIdentifier="{name}" {how[each]}/>' for each in ordered)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="g" numberOfEventIndicators=
"{int(indicated)}">{kind}<ModelVariables>{"".join(variables)}</ModelVariables><ModelStructure>
<Outputs><Unknown index="{first + 2}"{said}/></Outputs>
<Derivatives><Unknown index="{first + 1}"/></Derivatives></ModelStructure></fmiModelDescription>"""


def _third(name: str, kinds: Sequence[str], inputs: Sequence[str]) -> str:
    driven = "".join(
        f'<Float64 name="{each}" valueReference="{i}" causality="input" start="0"/>'
        for i, each in enumerate(inputs)
    )
    kind = "".join(f'<{each} modelIdentifier="{name}"/>' for each in sorted(kinds, reverse=True))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="g">{kind}
<ModelVariables><Float64 name="time" valueReference="100" causality="independent"
variability="continuous"/>{driven}<Float64 name="x" valueReference="2" causality="local"
initial="exact" start="0"/><Float64 name="der(x)"
valueReference="9" causality="local" derivative="2"/><Float64 name="y"
valueReference="3" causality="output"/>
<Float64 name="k" valueReference="4" causality="parameter" variability="tunable" initial="exact"
start="1"/></ModelVariables><ModelStructure><Output valueReference="3"/>
<ContinuousStateDerivative valueReference="9"/></ModelStructure></fmiModelDescription>"""
