"""Record, identify and validate models of a control laboratory's rig."""

from __future__ import annotations

from typing import Any

from armrig_core.process.imports import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return the object of a public name, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("armrig")
    name = _EARLIER_NAMES.get(name, name)
    if name not in __all__:
        raise AttributeError(_no_attribute(name), name=name)
    return public(__name__, name)


_EARLIER_NAMES = {"SubspaceFit": "Fit", "MultivariableFit": "Fit"}
"""Public names of earlier releases, and the present names."""
_OTHER_NAMES = {
    "PlannedModel": "Fit.of_channel",
    "iddata": "Dataset",
    "resid": "residuals",
    "ssest": "n4sid",
    "tfest": "tf",
    "procest": "process",
    "c2d": "Fit.to_discrete",
    "d2c": "Fit.to_continuous",
    "greyest": "greybox",
    "idinput": "telegraph",
    "checkFeedback": "open_loop",
    "delayest": "delay",
    "selstruc": "select_orders",
    "arxstruc": "select_orders",
    "impulseest": "impulse_response",
    "pidtune": "pid",
    "dlqr": "lqg",
    "lqr": "lqg",
    "margin": "check_law",
    "cra": "correlation",
}
"""Functions of the System Identification Toolbox and of earlier releases, and the present names."""


def _no_attribute(name: str) -> str:
    if name in _OTHER_NAMES:
        return f"armrig has no {name}; use armrig.{_OTHER_NAMES[name]}"
    near = [known for known in __all__ if known.casefold() == name.casefold()]
    meant = f"; did you mean armrig.{near[0]}?" if near else ""
    return f"module {__name__!r} has no attribute {name!r}{meant}"


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
