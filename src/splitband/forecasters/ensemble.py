"""Forecast by the median of several trainings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self, Unpack, final

from splitband.forecasters.base import Forecaster, Training
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.prediction import (
    ForecastContext,
    extrapolated,
    median,
    median_components,
)
from splitband.forecasters.steps import State, Steps
from splitband.records import Record, check_alike
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.training import Progress

if TYPE_CHECKING:
    import torch


@final
class Ensemble(Forecaster):
    """The median of several forecasters, each fitted with a different seed.

    At each sample it is the prediction in the middle, or the mean of the two in the middle.

    Parameters
    ----------
    member : Template of all members, or a list of one template for each, whose sizes and settings
        may differ.
    count : Number of members. `fit(seed=s)` fits them with the seeds `s * count`, `s * count + 1`,
        ..., so that the ensembles of two seeds share no member.
    name : By default that of the member.
    seeds : In place of `count`: the seeds of the members for `fit(seed=0)`.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> short = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    >>> model = sb.Ensemble(sb.Single(sb.GRU(4), short), count=2).fit(record, seed=0)
    >>> model.name, model.predict(20).y.shape
    ('gru', (20, 1))
    """

    forgets = True
    state_types: ClassVar[Mapping[str, Any]] = {"members": "templates"}

    def __init__(
        self,
        member: Forecaster | Sequence[Forecaster],
        count: int = 3,
        name: str | None = None,
        seeds: Sequence[int] | None = None,
    ) -> None:
        if not isinstance(member, Forecaster):
            member = [*member]
            count = len(member)
            if not count:
                raise InputError("member must be a forecaster or several, got none")
        if seeds is not None:
            seeds = [whole("seeds", seed, None) for seed in seeds]
            count = len(seeds)
            if count < 1 or min(seeds) < 0 or len(set(seeds)) < count:
                raise InputError(f"seeds must be different numbers from 0 on, got {[*seeds]}")
            if isinstance(member, list) and len(member) != count:
                raise InputError(
                    f"seeds must be one for each of {len(member)} members, got {seeds}"
                )
        count = whole("count", count)
        self.member, self.count, self._name = member, count, name
        self._seeds = None if seeds is None else tuple(seeds)
        self.members: list[Forecaster] = []

    @classmethod
    def of(cls, members: Sequence[Forecaster]) -> Ensemble:
        """Return the ensemble of forecasters that were fitted to the same records."""
        fits = [member.require_fitted() for member in members]
        for each in fits[1:]:
            check_alike(each.record, fits[0].record, "members")
            if not each.begins_and_ends_like(fits[0]):
                raise InputError(
                    "members must be fitted to the same record, got "
                    f"{fits[0].begin + len(fits[0].record)} samples of one and "
                    f"{each.begin + len(each.record)} of another"
                )
        seeds = [each.report.seed for each in fits]
        if len(set(seeds)) < len(seeds):  # members of different settings
            seeds = [*range(len(seeds))]
        ensemble = cls([member.clone() for member in members], seeds=seeds)
        ensemble._take(members, 0)
        return ensemble

    @property
    def templates(self) -> list[Forecaster]:
        """Return the unfitted template of each member."""
        return [self.member] * self.count if isinstance(self.member, Forecaster) else [*self.member]

    def _take(self, members: Sequence[Forecaster], seed: int) -> None:
        """Take fitted members, and combine their reports."""
        self.members, self.delays = [*members], members[0].delays
        reports = [member.require_fitted().report for member in members]
        notes = tuple(f"seed {r.seed}: {note}" for r in reports for note in r.notes)
        cut, growth = any(r.cut for r in reports), max(r.growth for r in reports)
        seconds = sum(r.seconds for r in reports)
        reach = min((r.reach for r in reports if r.reach is not None), default=None)
        report = FitReport(seed, seconds, reports[0].losses, notes, cut, growth, reach)
        longest = max((m.require_fitted() for m in members), key=lambda fitted: len(fitted.record))
        self.fitted = replace(longest, report=report)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return the seeds of the members for `fit(seed=0)`."""
        return tuple(range(self.count)) if self._seeds is None else self._seeds

    @property
    def name(self) -> str:
        return self._name or self.templates[0].name

    @property
    def parameters(self) -> dict[str, Any]:
        return self.members[0].parameters if self.members else {}

    @property
    def warmup(self) -> int:
        """Return the longest warm-up of the members; before `fit`, that of the first template."""
        return max([m.warmup for m in self.members], default=self.templates[0].warmup)

    def to(self, device: str | torch.device) -> Self:
        for member in self.members:
            member.to(device)
        return super().to(device)

    def untrained(self) -> Forecaster:
        """Return it not fitted, with the settings and bands that its members' fits have chosen."""
        members = [member.untrained() for member in self.members or self.templates]
        return type(self)(members, name=self._name, seeds=self.seeds)

    def first_needed(self) -> int:
        return min(member.first_needed() for member in self.members)

    def in_words(self) -> str:
        return (self.members or self.templates)[0].in_words()

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        seed, start, progress = how["seed"], how["start"], how["progress"]
        starts: list[Forecaster | None] = [None] * self.count
        if start is not None:
            starts = [*start.members] if isinstance(start, Ensemble) else []
        if len(starts) != self.count:
            raise InputError(f"start must be a trained median of {self.count}, got {start!r}")
        bases = [*how["bases"]]
        for i, template in enumerate(self.templates):
            member = template.clone()._fit(
                records,
                seed=seed * (max(self.seeds) + 1) + self.seeds[i],
                start=starts[i],
                progress=None if progress is None else _shifted(progress, i, self.count),
                bases=bases,
            )
            self.members.append(member)
            bases += [each for each in member.fitted_bases if not each.random]
        self._take(self.members, seed)

    def extrapolate(self, known: ForecastContext) -> dict[str, Array]:
        """Return the median of the members, by component where all have the same components."""
        found = [extrapolated(member, known) for member in self.members]
        parts = [each for _, each in found]
        if any(each.keys() != parts[0].keys() for each in parts):
            parts = [{"": y} for y, _ in found]
        return median_components(parts, [y for y, _ in found])

    def run_over(self, known: ForecastContext) -> Forecaster:
        new = copy(self)
        new.members = [member.run_over(known) for member in self.members]
        return new

    def step_form(self) -> Steps:
        return MedianSteps([member.step_form() for member in self.members])

    def doubts(self, known: ForecastContext) -> list[str]:
        return [*dict.fromkeys(said for member in self.members for said in member.doubts(known))]

    def describe(self) -> str:
        return self.members[0].describe() if self.members else ""


@final
class MedianSteps(Steps):
    """Predict the median of several step forms, once all of them predict."""

    def __init__(self, members: Sequence[Steps]) -> None:
        self.members = members
        self.note = " ".join(dict.fromkeys(member.note for member in members if member.note))
        self.ahead = max(member.ahead for member in members)
        self.simulated = any(member.simulated for member in members)
        self.warmup = max(member.warmup for member in members)

    def begin(self, history: ForecastContext | None) -> State:
        return {"members": [member.begin(history) for member in self.members]}

    def warmed_up(self, state: State) -> State:
        return {"members": [member.warmed_up(own) for member, own in self._each(state)]}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        return self._median(
            member.run(own, u, y_sim[: 1 + member.ahead]) for member, own in self._each(state)
        )

    def advance(
        self, state: State, u: Array, y_sim: Array, needed: Any = True
    ) -> tuple[State, Array]:
        """Return the states one sample later, and the median."""
        return self._median(
            member.advance(own, u, y_sim[: 1 + member.ahead], needed)
            for member, own in self._each(state)
        )

    def correct(self, state: State, y: Array) -> State:
        return {"members": [member.correct(own, y) for member, own in self._each(state)]}

    def _each(self, state: State) -> Iterable[tuple[Steps, State]]:
        return zip(self.members, state["members"], strict=True)

    def _median(self, moved: Iterable[tuple[State, Array]]) -> tuple[State, Array]:
        states, predicted = zip(*moved, strict=True)
        return {"members": [*states]}, median(predicted)


def fitted_ensemble(models: Sequence[Forecaster], held_out: HeldOut | None) -> Forecaster:
    """Return the ensemble of fitted models with these errors; one of seed 0 is itself."""
    usual = [model.require_fitted().report.seed for model in models] == [0]
    model = models[0] if usual or not models[0].random else Ensemble.of(models)
    model.held_out = held_out
    return model


def _shifted(
    progress: Callable[[Progress], None], done: int, count: int
) -> Callable[[Progress], None]:
    """Return a callback that converts the progress of a member to that of the ensemble."""
    return lambda at: progress(replace(at, share=(done + at.share) / count))
