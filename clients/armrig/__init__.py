"""Record, identify and validate models of a control laboratory's rig."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armrig.dataset import Dataset, merge
    from armrig.estimation.arx import arx
    from armrig.estimation.oe import oe
    from armrig.excitation import step, telegraph
    from armrig.fit import Fit
    from armrig.jitter import sampling_statistics
    from armrig.listening import stream
    from armrig.physics import ArmParameters, arm, chassis
    from armrig.preprocess import detrend, difference
    from armrig.recording import Recording, RecordingError, load
    from armrig.rig import Rig
    from armrig.session import RigError
    from armrig.validation import compare, residuals

__all__ = [
    "ArmParameters",
    "Dataset",
    "Fit",
    "Recording",
    "RecordingError",
    "Rig",
    "RigError",
    "arm",
    "arx",
    "chassis",
    "compare",
    "detrend",
    "difference",
    "load",
    "merge",
    "oe",
    "residuals",
    "sampling_statistics",
    "step",
    "stream",
    "telegraph",
]

# Each name's module is imported when the name is first asked for (PEP 562): `import armrig` and
# `armrig --help` are quick, and who only reads a recording never loads zenoh.
_MODULES = {
    "dataset": ("Dataset", "merge"),
    "estimation.arx": ("arx",),
    "estimation.oe": ("oe",),
    "excitation": ("step", "telegraph"),
    "fit": ("Fit",),
    "physics": ("ArmParameters", "arm", "chassis"),
    "preprocess": ("detrend", "difference"),
    "recording": ("Recording", "RecordingError", "load"),
    "rig": ("Rig",),
    "session": ("RigError",),
    "listening": ("stream",),
    "jitter": ("sampling_statistics",),
    "validation": ("compare", "residuals"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Return a public name, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("armrig")
    if name not in _HOMES:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
