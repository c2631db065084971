"""Define `splitband compare`."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import typer

from splitband.cli import INTERRUPTED, options, showing
from splitband.cli.comparing import Request, planned
from splitband.cli.live import running, workers
from splitband.cli.usage import command_of, usage
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.plan import Plan
from splitband.evaluation.run import run
from splitband.forecasters.names import HYBRIDS
from splitband.forecasters.network import Network
from splitband.report import results, words
from splitband.report.page.parts import Usage
from splitband.report.results import MODEL_FOLDER
from splitband.report.table import in_words, of_comparison
from splitband.runtime.files import CHECKPOINTS


@options.with_groups
def compare(
    context: typer.Context,
    asked: Request,
    jobs: options.Jobs = None,
    out: options.Out = Path("out"),
    cluster: options.Cluster = None,
) -> None:
    """Compare models of a record, and recommend one.

    Every method is trained on the first --train samples and predicts the rest, and with --test
    other records. The table shows fit % and RMSE. OUT gets a page to send on (report.html),
    predictions and results.json.

    The recommended method is chosen on training samples only: trained on three quarters of them,
    it predicts the last quarter best. An interval around its forecast should hold 90 % of what is
    measured.

    OUT/model is the recommended method as it was trained, for `splitband simulate`; --refit trains
    it on the whole record.

    How networks are trained is searched round by round until --budget is over: a table after
    every round, and OUT/model is the best model so far. Ctrl-C ends with what there is. --rounds
    limits the work in place of the time; --window, --epochs, --learning-rate, --lr-milestones,
    --recipe constant-rate and --like replace the search. --calibrate and --conditioned add rows.
    """
    result = compared(context, planned(asked), out, jobs, cluster)
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
    if not result.interrupted:
        shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
    _show(result, out, used)
    return result


def _show(result: Comparison, out: Path, used: Usage) -> None:
    """Print the table, the recommendation with its reason, warnings, and how to use the model."""
    plan, trial, best = result.plan, result.require_trial(), result.recommended
    showing.table(of_comparison(result))
    showing.console.print(result.clock.in_words())
    kind = in_words(best, result.methods)
    why = " ".join(words.why(trial, plan.train))
    showing.console.print(f"\nrecommended: {words.named(best, kind)}. {why}")
    fitted = result.fits[best][0].fitted
    if isinstance(fitted, Network) and fitted._trained_in is not None:
        showing.console.print(words.of_bands(fitted._trained_in, plan.training))
    choice = plan.bands.choice
    if choice and choice.simulator_helps is False and not set(plan.names) & set(HYBRIDS):
        showing.console.print("hybrid models are left out; --methods brings them back")
    for message in words.warnings(result):
        showing.warn(message)
    for predicted, said in words.headline(result):
        showing.console.print(f"{predicted}: {', '.join(said)}", style="bold")
    for tested in result.residual_tests():
        showing.console.print(f"residual tests: {tested.verdict()}")
    showing.console.print(f"trained model: {out / MODEL_FOLDER}/\nresults: {out}/")
    showing.results_of(out, used)
