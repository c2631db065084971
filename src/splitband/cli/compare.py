"""Define `splitband compare`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import typer

from splitband.cli import INTERRUPTED, options, printing
from splitband.cli.display import running, workers
from splitband.cli.requests import Request, planned
from splitband.cli.usage import command_of, usage
from splitband.comparison.plan import Plan
from splitband.comparison.result import Comparison
from splitband.comparison.run import run
from splitband.forecasters.base import titled
from splitband.report import results, words
from splitband.report.page import NAME as PAGE
from splitband.report.page.parts import Usage
from splitband.report.tables import of_comparison
from splitband.runtime.outputs import MODEL_FOLDER, finished_comparison


@options.with_groups
def compare(
    context: typer.Context,
    asked: Request,
    jobs: options.Jobs = None,
    out: options.Out = Path("out"),
    cluster: options.Cluster = None,
    skip_done: options.SkipDone = False,
) -> None:
    """Compare models of a record and recommend one.

    Every method is trained on the first --train samples, and predicts the rest and the records of
    --test. The command prints the recommended method, then a table of fit % and RMSE.
    --verbose adds the reasons and what each fit has chosen. OUT contains a page to share
    (report.html), the predictions and results.json.

    The recommended method has the lowest held-out error: trained on three quarters of the training
    samples, it predicts the last quarter best. A network must be 10 % better than other methods.
    The interval around a prediction should contain 90 % of the measured samples.

    OUT/model is the recommended model, for `splitband simulate`. --refit trains it again on the
    whole record.

    The training settings of networks are searched round by round until --budget is over. After
    every round there is a table, and OUT/model is the best model so far. Ctrl-C stops early and
    keeps it. --rounds limits the work instead of the time. --window, --epochs, --learning-rate,
    --recipe constant-rate and --like replace the search.
    """
    if skip_done and (done := finished_comparison(out)) is not None:
        printing.console.print(
            f"{out} has a finished comparison of {done} already: nothing is done"
        )
        printing.facts_of(out)
        return
    result = compared(context, planned(asked, context), out, jobs, cluster)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)


def compared(
    context: typer.Context, plan: Plan, out: Path, jobs: int | None, cluster: str | None = None
) -> Comparison:
    """Run a planned comparison, show it while it runs, write its results and print them."""
    facts = command_of(context)
    with workers(jobs, cluster) as where, running(plan, out, facts) as how:
        result = run(plan, **where, **how)
    plan = replace(result.plan, refit=result.refit is not None)
    used = usage(facts["command"], facts["arguments"], out, plan, result.model)
    results.save(result, out, facts, used)
    _show(result, out, used)
    return result


def _show(result: Comparison, out: Path, used: Usage) -> None:
    """Print the answer, then the table, then the time; with --verbose the reasons, too."""
    listed, best, say = of_comparison(result), result.recommended, printing.console.print
    chosen = ", chosen by held-out error" if len(listed.rows) > 1 else ""
    say(f"\nrecommended: {titled(best, listed.label(best))}{chosen}", style="bold")
    for predicted, said in words.headline(result):
        say(f"{predicted}: {', '.join(said)}", style="bold")
    if result.model.parameters:
        say(f"parameters: {result.fits[best][0].description}")
    printing.warn_of(words.warnings(result), max(len(words.pressing(result)), 1))
    say(f"model: {out / MODEL_FOLDER}/, page: {out / PAGE}\n")
    # The warnings say why a method has no result.
    printing.table(replace(listed, rows=dict.fromkeys(listed.rows, "")))
    if printing.verbose():
        _explain(result, listed.labels)
    printing.use_of(used)
    say(result.clock.in_words())
    printing.facts_of(out)


def _explain(result: Comparison, called: Mapping[str, str]) -> None:
    """Print why the method is recommended, and what its residuals say."""
    plan, say = result.plan, printing.console.print
    say(" ".join(words.why(result.require_trial(), plan.train, called, plan.ahead)))
    for finding in words.findings(result):
        say(finding)
