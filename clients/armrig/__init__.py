"""Record, identify and validate models of a control laboratory's rig."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from armrig_core.errors import ArmrigError, FileError, InputError

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, merge
    from armrig.data.files.loading import load_data
    from armrig.data.treatment import (
        detrend,
        difference,
        drift,
        hampel,
        prefilter,
        resample,
        retrend,
    )
    from armrig.estimation.ararx import ararx
    from armrig.estimation.armax import armax
    from armrig.estimation.arx import arx
    from armrig.estimation.bj import bj
    from armrig.estimation.iv4 import iv4
    from armrig.estimation.n4sid import n4sid
    from armrig.estimation.nonparametric.bla import bla
    from armrig.estimation.nonparametric.correlation import correlation
    from armrig.estimation.nonparametric.etfe import etfe
    from armrig.estimation.nonparametric.impulse import impulse_response
    from armrig.estimation.nonparametric.sampling_time import sampling_time
    from armrig.estimation.nonparametric.spectral import spa
    from armrig.estimation.nonparametric.step_analysis import step_analysis
    from armrig.estimation.oe import oe
    from armrig.estimation.order_table import select_orders
    from armrig.estimation.pem import pem
    from armrig.estimation.recursive import RarxState, rarx, rarx_start, rarx_step
    from armrig.excitation import (
        chirp,
        from_csv,
        multisine,
        prbs,
        staircase,
        step,
        telegraph,
        white_noise,
    )
    from armrig.excitation.experiment_design import (
        PlannedModel,
        predicted_parameter_std,
        predicted_std,
    )
    from armrig.excitation.input_description import describe_input
    from armrig.models.fit import Fit
    from armrig.models.model_file import load_fit
    from armrig.models.subspace_fit import SubspaceFit
    from armrig.physics.grey_box.agreement import agreement
    from armrig.physics.grey_box.estimate import greybox
    from armrig.physics.grey_box.fit import GreyFit
    from armrig.physics.grey_box.inverse_dynamics import inverse_dynamics
    from armrig.physics.grey_box.split_study import split_study
    from armrig.physics.integrators.accuracy import convergence, sinusoid
    from armrig.physics.integrators.exact import exact
    from armrig.physics.integrators.stability import stability_limit
    from armrig.physics.integrators.step_choice import recommend_step
    from armrig.physics.integrators.stepping import integrate
    from armrig.physics.physical_model import physical_model
    from armrig.physics.step_response import characteristics, step_sensitivities
    from armrig.physics.systems import ArmParameters, arm, chassis, rehearse
    from armrig.recordings.catalogue import Catalogue, catalogue
    from armrig.recordings.jitter import sampling_statistics
    from armrig.recordings.loading import load
    from armrig.recordings.recording import Recording
    from armrig.recordings.usability import data_verdict
    from armrig.rig.client import Rig
    from armrig.rig.live_gaps import LiveGap
    from armrig.rig.session import RigError
    from armrig.rig.telemetry_stream import stream
    from armrig.validation.advice.advice import advice
    from armrig.validation.comparison import compare
    from armrig.validation.feedback_and_delay.delay import delay
    from armrig.validation.feedback_and_delay.open_loop import open_loop
    from armrig.validation.model_search import search
    from armrig.validation.residuals import residuals
    from armrig.validation.search_result import SearchResult
    from armrig.validation.structure_hints import structure_hints

__all__ = [
    "ArmParameters",
    "ArmrigError",
    "Catalogue",
    "Dataset",
    "FileError",
    "Fit",
    "GreyFit",
    "InputError",
    "LiveGap",
    "PlannedModel",
    "RarxState",
    "Recording",
    "Rig",
    "RigError",
    "SearchResult",
    "SubspaceFit",
    "advice",
    "agreement",
    "ararx",
    "arm",
    "armax",
    "arx",
    "bj",
    "bla",
    "catalogue",
    "characteristics",
    "chassis",
    "chirp",
    "compare",
    "convergence",
    "correlation",
    "data_verdict",
    "delay",
    "describe_input",
    "detrend",
    "difference",
    "drift",
    "etfe",
    "exact",
    "from_csv",
    "greybox",
    "hampel",
    "impulse_response",
    "integrate",
    "inverse_dynamics",
    "iv4",
    "load",
    "load_data",
    "load_fit",
    "merge",
    "multisine",
    "n4sid",
    "oe",
    "open_loop",
    "pem",
    "physical_model",
    "prbs",
    "predicted_parameter_std",
    "predicted_std",
    "prefilter",
    "rarx",
    "rarx_start",
    "rarx_step",
    "recommend_step",
    "rehearse",
    "resample",
    "residuals",
    "retrend",
    "sampling_statistics",
    "sampling_time",
    "search",
    "select_orders",
    "sinusoid",
    "spa",
    "split_study",
    "stability_limit",
    "staircase",
    "step",
    "step_analysis",
    "step_sensitivities",
    "stream",
    "structure_hints",
    "telegraph",
    "white_noise",
]

# Each name's module is imported when the name is first asked for (PEP 562): `import armrig` and
# `armrig --help` are quick, and who only reads a recording never loads zenoh.
_MODULES = {
    "validation.advice.advice": ("advice",),
    "data.dataset": ("Dataset", "merge"),
    "data.files.loading": ("load_data",),
    "estimation.ararx": ("ararx",),
    "estimation.armax": ("armax",),
    "estimation.arx": ("arx",),
    "estimation.bj": ("bj",),
    "estimation.iv4": ("iv4",),
    "estimation.n4sid": ("n4sid",),
    "estimation.oe": ("oe",),
    "estimation.order_table": ("select_orders",),
    "estimation.pem": ("pem",),
    "estimation.recursive": ("RarxState", "rarx", "rarx_start", "rarx_step"),
    "excitation": (
        "chirp",
        "from_csv",
        "multisine",
        "prbs",
        "staircase",
        "step",
        "telegraph",
        "white_noise",
    ),
    "excitation.experiment_design": ("PlannedModel", "predicted_parameter_std", "predicted_std"),
    "excitation.input_description": ("describe_input",),
    "validation.feedback_and_delay.delay": ("delay",),
    "validation.feedback_and_delay.open_loop": ("open_loop",),
    "models.fit": ("Fit",),
    "physics.grey_box.agreement": ("agreement",),
    "physics.grey_box.estimate": ("greybox",),
    "physics.grey_box.fit": ("GreyFit",),
    "physics.grey_box.inverse_dynamics": ("inverse_dynamics",),
    "physics.grey_box.split_study": ("split_study",),
    "physics.integrators.accuracy": ("convergence", "sinusoid"),
    "physics.integrators.step_choice": ("recommend_step",),
    "physics.integrators.exact": ("exact",),
    "physics.integrators.stability": ("stability_limit",),
    "physics.integrators.stepping": ("integrate",),
    "physics.step_response": ("characteristics", "step_sensitivities"),
    "estimation.nonparametric.bla": ("bla",),
    "estimation.nonparametric.correlation": ("correlation",),
    "estimation.nonparametric.etfe": ("etfe",),
    "estimation.nonparametric.impulse": ("impulse_response",),
    "estimation.nonparametric.sampling_time": ("sampling_time",),
    "estimation.nonparametric.spectral": ("spa",),
    "estimation.nonparametric.step_analysis": ("step_analysis",),
    "validation.structure_hints": ("structure_hints",),
    "physics.systems": ("ArmParameters", "arm", "chassis", "rehearse"),
    "data.treatment": (
        "detrend",
        "difference",
        "drift",
        "hampel",
        "prefilter",
        "resample",
        "retrend",
    ),
    "recordings.catalogue": ("Catalogue", "catalogue"),
    "recordings.loading": ("load",),
    "recordings.recording": ("Recording",),
    "rig.client": ("Rig",),
    "rig.live_gaps": ("LiveGap",),
    "rig.session": ("RigError",),
    "physics.physical_model": ("physical_model",),
    "rig.telemetry_stream": ("stream",),
    "models.model_file": ("load_fit",),
    "validation.model_search": ("search",),
    "validation.search_result": ("SearchResult",),
    "recordings.jitter": ("sampling_statistics",),
    "models.subspace_fit": ("SubspaceFit",),
    "recordings.usability": ("data_verdict",),
    "validation.comparison": ("compare",),
    "validation.residuals": ("residuals",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Return a public name, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("armrig")
    if name not in _HOMES:
        raise AttributeError(_no_attribute(name), name=name)
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


_OF_MATLAB = {
    "iddata": "Dataset",
    "resid": "residuals",
    "ssest": "n4sid",
    "tfest": "oe",
    "greyest": "greybox",
    "idinput": "telegraph",
    "checkFeedback": "open_loop",
    "delayest": "delay",
    "selstruc": "select_orders",
    "arxstruc": "select_orders",
    "impulseest": "impulse_response",
    "cra": "correlation",
}
"""Functions of the System Identification Toolbox, and what stands for them."""


def _no_attribute(name: str) -> str:
    if name in _OF_MATLAB:
        return f"armrig has no {name}; what stands for it is armrig.{_OF_MATLAB[name]}"
    near = [known for known in __all__ if known.casefold() == name.casefold()]
    meant = f"; did you mean armrig.{near[0]}?" if near else ""
    return f"module {__name__!r} has no attribute {name!r}{meant}"


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
