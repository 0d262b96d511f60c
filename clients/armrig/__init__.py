"""Record, identify and validate models of a control laboratory's rig."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from armrig_core.process.imports import homes, public

__all__ = list(homes(__name__))  # in the stub, `__init__.pyi`


def __getattr__(name: str) -> Any:
    """Return the object of a public name, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("armrig")
    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    if name in __all__:
        return public(__name__, name)
    if present := _present_name(name):
        return _get_by_earlier_name(name, present)
    raise AttributeError(_no_attribute(name), name=name)


_PACKAGES = ("control", "physics", "plots")
"""Packages with public names of their own."""
_EARLIER_NAMES = {
    "SubspaceFit": "Fit",
    "MultivariableFit": "Fit",
    "from_csv": "input_from_file",
}
"""Names of earlier releases, and the present names. They end with release 0.4, as do the names of
`armrig.control` and `armrig.physics` without the package."""


def _present_name(name: str) -> str:
    """Return the present name of an earlier name, "" for any other name."""
    for package in ("control", "physics"):
        if name in import_module(f"{__name__}.{package}").__all__:
            return f"{package}.{name}"
    return _EARLIER_NAMES.get(name, "")


def _get_by_earlier_name(name: str, present: str) -> Any:
    """Return the object that a name of an earlier release means, and warn."""
    import warnings

    text = f"armrig.{name} is armrig.{present} now; the earlier name ends with armrig 0.4"
    warnings.warn(text, DeprecationWarning, stacklevel=3)
    package, _, last = f"{__name__}.{present}".rpartition(".")
    return getattr(import_module(package), last)


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
    "pidtune": "control.pid",
    "dlqr": "control.lqg",
    "lqr": "control.lqg",
    "margin": "control.check_law",
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
    return [*__all__, *_PACKAGES, "__version__"]
