"""Choose training settings from the samples of a record alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from splitband.data import Record
from splitband.training.settings import Settings, default_warmup
from splitband.training.window_starts import window_starts

Recipe = Literal["default", "constant-rate"]


ENOUGH_WINDOWS = 0.25
"""Share of all windows that must have a warm-up without gaps, or else warm-ups are shortened."""


def recipe_settings(recipe: Recipe, training: Record, others: Sequence[Record] = ()) -> Settings:
    """Return a recipe's settings for a record, with a shorter warm-up if gaps leave few windows.

    Windows fit into the `others`, the further training records, too.
    """
    samples = len(training)
    settings = Settings.of(samples) if recipe == "default" else constant_rate_settings(samples)
    longest = max(min(map(len, others), default=settings.window), 2)
    if longest < settings.window:
        warmup = min(settings.warmup, default_warmup(longest))
        settings = replace(settings, window=longest, warmup=warmup)
    if training.measured is None or samples < settings.window:
        return settings
    tried = []
    for part in (1, 2, 4):
        warmup = max(settings.warmup // part, 1)
        starts = window_starts([training], settings.window, warmup)
        tried.append((len(starts), warmup))
        if len(starts) >= ENOUGH_WINDOWS * (samples - settings.window + 1):
            break
    windows, warmup = max(tried)
    if recipe == "default" and windows:
        settings = Settings.of(samples, windows)
    return replace(settings, warmup=warmup)


def constant_rate_settings(train: int) -> Settings:
    """Return settings like the paper's: Adam at 1e-3 on windows of at most 250 samples.

    The columns of its tables, one for each of its systems, are `reproduction.settings`.
    """
    window = min(250, max(2, train // 2))
    return Settings(window, default_warmup(window))
