"""Tasks of a batch. A task is a plain value, because it is sent to other processes."""

from __future__ import annotations

import hashlib

import msgspec
from armrig_core.telemetry import THETA_1, OutputName

from armrig.estimation.request import Request


class Identify(Request, frozen=True, kw_only=True, tag="identify"):
    """Estimate a model from each recording."""

    signal: OutputName = THETA_1
    """Output of the model."""
    detrend: bool = False


class Validate(msgspec.Struct, frozen=True, kw_only=True, tag="validate"):
    """Compare one model with each recording."""

    model: str
    """Content of a model file that `Fit.save` wrote. A path would not suffice, because other
    machines may not have the file."""
    detrend: bool = False


class Verify(msgspec.Struct, frozen=True, kw_only=True, tag="verify"):
    """Check each recording, as `armrig verify` does."""


class Report(msgspec.Struct, frozen=True, kw_only=True, tag="report"):
    """Write a report of each recording with an exciting input, and of its validation recording."""

    folder: str
    """Folder of the PDFs; the name of a PDF contains the name of its recording."""
    na: int
    nb: int
    nf: int
    nk: int


Task = Identify | Validate | Verify | Report


def name_of(task: Task) -> str:
    """Return the name of a task on the command line."""
    return str(type(task).__struct_config__.tag)


def digest(task: Task) -> str:
    """Return a hash of the task and its options; results with another hash are not reused.

    An option that is None is left out, so that a new field does not change earlier hashes.
    """
    asked = {name: x for name, x in msgspec.to_builtins(task).items() if x is not None}
    return sha256(msgspec.json.encode(asked, order="sorted").decode())


def sha256(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()
