"""Render a program as C99 that allocates no memory and needs nothing but math.h."""

from __future__ import annotations

from textwrap import wrap

from splitband.export.c_statements import Precision, Renderer
from splitband.export.graph import Symbol
from splitband.export.program import Program


def render(program: Program, precision: Precision) -> tuple[str, str]:
    """Return header and source of a program."""
    names: dict[Symbol, str] = {}
    inputs = iter(program.block.inputs)
    for leaf, symbol in zip(program.leaves, inputs, strict=False):
        names[symbol] = f"s->{leaf.name}"
    for name, symbol in zip(("y", "u", "y_sim"), program.block.inputs[-3:], strict=True):
        names[symbol] = name
    renderer = Renderer(precision, names)
    renderer.block(program.block)
    *state, predicted, ready = renderer.stored_outputs(program.block)
    with renderer.braces(f"if (!observed && !{ready})"):
        renderer.write("return 1;")
    for leaf, new in zip(program.leaves, state, strict=True):
        if new:
            renderer.copy(leaf.begun.shape, f"s->{leaf.name}", new)
    with renderer.braces("if (!observed)"):
        renderer.copy((program.record.ny,), "predicted", predicted)
    renderer.write("return 0;")
    return _header(program, precision), _source(program, renderer)


def _header(program: Program, precision: Precision) -> str:
    name, record = program.name, program.record
    fields = [
        f"    {precision} {leaf.name}{f'[{leaf.begun.size}]' if leaf.begun.ndim else ''};"
        for leaf in program.leaves
        if leaf.begun.size
    ] or ["    char nothing;"]
    outputs, inputs = record.labels
    signals = [f"y[{record.ny}]: {', '.join(outputs)}"]
    if "u" in program.given:
        signals.append(f"u[{record.nu}]: {', '.join(inputs)}")
    if "y_sim" in program.given:
        shape = [*program.given["y_sim"]]
        both = ", then of the next one" * (shape[0] > 1)
        units = ", in the units of y" * (outputs != [*record.columns])
        signals.append(f"y_sim{shape}: the simulator's output of this sample{both}{units}")
    listed = "\n".join(f" *   {_comment(signal)}" for signal in signals)
    given = [signal for signal in program.given if signal != "y"]
    others = "".join(f", const {precision} *{signal}" for signal in given)
    finite = f"; {' and '.join(given)} must be finite" if given else ""
    said = (
        f"NaN in y marks a sample that was not measured{finite}. All state is in the struct, which "
        f"{name}_init or {name}_clear must begin. {program.note}"
    )
    said = "\n * ".join(wrap(said, 96))
    guard = f"{name.upper()}_H"
    begins = "Begin with nothing measured: the simulator was not available at the export."
    if program.begins:
        begins = f"Go on from the end of the {program.begins}."
    return f"""/* {_comment(program.forecaster.name)}, exported by splitband.
 *
 * One sample every {record.sampling_time:.9g} s:
{listed}
 * {said}
 */
#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

typedef struct {{
{chr(10).join(fields)}
}} {name}_state;

/* {begins} */
void {name}_init({name}_state *s);

/* Begin with nothing measured: {program.cleared}. */
void {name}_clear({name}_state *s);

/* Take the next measured sample. */
void {name}_observe({name}_state *s, const {precision} *y{others});

/* Predict the next sample, which is not measured. Returns 0, or 1 where too few samples have been
 * observed; y and the state are left as they are then. */
int {name}_step({name}_state *s{others}, {precision} *y);

#ifdef __cplusplus
}}
#endif

#endif
"""


def _source(program: Program, renderer: Renderer) -> str:
    name = program.name
    precision = renderer.precision
    setters = []
    for begun in (True, False):
        body = Renderer(precision, {})
        body.constants = renderer.constants
        for leaf in program.leaves:
            values = leaf.begun if begun else leaf.cleared
            if not leaf.begun.ndim:
                body.write(f"s->{leaf.name} = {body.number(float(values))};")
            elif leaf.begun.size and (values == values.flat[0]).all():
                value = body.number(float(values.flat[0]))
                body.fill(values.size, f"s->{leaf.name}", value)
            elif leaf.begun.size:
                body.copy((values.size,), f"s->{leaf.name}", body.array(values))
        setters.append("\n".join(body.lines or ["    (void)s;"]))
    sigmoid = ""
    if "sigmoid" in renderer.functions:
        sigmoid = (
            "static real sigmoid(real x)\n{\n"
            f"    return 1 / (1 + {renderer.function('exp')}(-x));\n}}\n\n"
        )
    constants = "\n".join(text for _, text in renderer.constants.values())
    others = [s for s in program.given if s != "y"]
    taken = "".join(f", const real *{s}" for s in others)
    passed = "".join(f", {s}" for s in others)
    ny = program.record.ny
    nothing = ", ".join(["NAN"] * ny)
    body_of_tick = "\n".join(renderer.lines)
    unused = "".join(
        f"    (void){word};\n" for word in ("s", "y", *others) if _unused(word, body_of_tick)
    )
    return f"""#include <math.h>

#include "{name}.h"

typedef {precision} real;

{constants}

{sigmoid}static int tick({name}_state *s, const real *y{taken}, int observed, real *predicted)
{{
{unused}{body_of_tick}
}}

void {name}_init({name}_state *s)
{{
{setters[0]}
}}

void {name}_clear({name}_state *s)
{{
{setters[1]}
}}

void {name}_observe({name}_state *s, const real *y{taken})
{{
    tick(s, y{passed}, 1, 0);
}}

int {name}_step({name}_state *s{taken}, real *y)
{{
    static const real nothing[{ny}] = {{ {nothing} }};

    return tick(s, nothing{passed}, 0, y);
}}
"""


def _unused(word: str, body: str) -> bool:
    used = f"{word}->" if word == "s" else f"{word}["
    return used not in body


def _comment(text: str) -> str:
    """Return a text made safe for a C comment."""
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *")
