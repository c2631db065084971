"""What --device asks for: networks that are trained, or run, on an accelerator."""

from __future__ import annotations

from typing import TypeVar

from splitband.forecasters.base import Forecaster

AnyForecaster = TypeVar("AnyForecaster", bound=Forecaster)


def on_device(forecaster: AnyForecaster, device: str) -> AnyForecaster:
    """A forecaster whose network, if it has one, is trained and runs on a device."""
    if device != "cpu":
        check_device(device)
        forecaster.to(device)
    return forecaster


def check_device(device: str) -> None:
    """Raise ValueError, which names the option, for a device that is not there."""
    import torch  # noqa: PLC0415  it has been loaded by now

    try:
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"--device must be one that is there, got {device}: {reason}") from None
