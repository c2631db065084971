"""Results without what takes longest of them: pictures and pages."""

from pathlib import Path

import pytest


def nothing_drawn(patch: pytest.MonkeyPatch) -> None:
    """Let results be written without pictures, and with an empty page."""
    for figure in ("rollouts", "spectrum", "prediction"):
        patch.setattr(f"splitband.report.pictures.{figure}", lambda *_, **__: None)
    patch.setattr("splitband.report.pictures.save", lambda figure, path: None)
    for result in ("comparison", "forecast", "check"):
        patch.setattr(f"splitband.report.page.document.of_{result}", _empty_page)


def _empty_page(result: object, path: str | Path, *_: object) -> None:
    Path(path).write_text("", encoding="utf-8")
