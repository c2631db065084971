"""Results without what takes longest of them: pictures and pages."""

import pytest


def nothing_drawn(patch: pytest.MonkeyPatch) -> None:
    """Let results be written without pictures, and with an empty page."""
    for figure in ("rollouts", "prediction"):
        patch.setattr(f"splitband.report.pictures.{figure}", lambda *_, **__: None)
    patch.setattr("splitband.report.pictures.save", lambda figure, path: None)
    for result in ("comparison", "check", "inspection"):
        patch.setattr(f"splitband.report.page.pages.of_{result}", lambda *_: None)
    patch.setattr("splitband.report.page.document.html", lambda page: "")
