"""Options that several commands have."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Annotated, Any

import typer
from armrig_core.process.options import group, option, preset

RigId = Annotated[str, option("--rig", "Id of the rig.")]
Connect = Annotated[
    str | None,
    option(
        "--connect ENDPOINT",
        "zenoh endpoint of the daemon or a router, such as tls/HOST:7447.",
        "the configuration's [client] connect, otherwise the daemon on this machine",
    ),
]
SamplingTime = Annotated[
    float | None, option("--Ts", "Sampling time, in s, at most 60.", "the daemon's sampling time")
]
Json = Annotated[bool, option("--json", "Print JSON.")]
Verbose = Annotated[bool, option("-v --verbose", "Print all details.")]
CalibrationFile = Annotated[
    Path | None,
    option(
        "--calibration TOML",
        "Calibration file to use instead of the calibration in the recording.",
    ),
]


def _not_nan(seconds: float | None) -> float | None:
    if seconds is not None and isnan(seconds):
        raise typer.BadParameter("nan is not a time; give a number of seconds")
    return seconds


From = Annotated[
    float | None,
    option(
        "--from S",
        "Start of the samples to use, in s from the first sample of the file.",
        "the start of the file",
        callback=_not_nan,
    ),
]
To = Annotated[
    float | None,
    option(
        "--to S",
        "End of the samples to use, in s from the first sample of the file; a sample at this "
        "time is left out.",
        "the end of the file",
        callback=_not_nan,
    ),
]
ModelFile = Annotated[Path, option("--model JSON", "Model file written by identify --save.")]
Detrend = Annotated[bool, option("--detrend", "Subtract the mean of each signal of each file.")]


@dataclass(frozen=True, kw_only=True)
class _ModelOrders:
    na: int = preset(4, "Number of coefficients a (ARX).")
    nb: int = preset(4, "Number of coefficients b.")
    nf: int = preset(4, "Number of coefficients f (OE); an integrator counts as one.")
    nk: int = preset(1, "Delay from u to y, in samples.")


ModelOrders = Annotated[dict[str, Any], group(_ModelOrders, made=dict)]
"""Orders of the models of a study, by name."""
