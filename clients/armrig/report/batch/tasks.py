"""What a batch does with each recording. A task is a value: it is sent to other processes."""

from __future__ import annotations

import hashlib

import msgspec
from armrig_core.telemetry import THETA_1, OutputName

from armrig.estimation.request import Request


class Identify(Request, frozen=True, kw_only=True, tag="identify"):
    """Estimate a model from each recording."""

    signal: OutputName = THETA_1
    """What is the output."""
    detrend: bool = False


class Validate(msgspec.Struct, frozen=True, kw_only=True, tag="validate"):
    """Judge one model by each recording."""

    model: str
    """What `Fit.save` has written; the text itself, for other machines do not have the file."""
    detrend: bool = False


class Verify(msgspec.Struct, frozen=True, kw_only=True, tag="verify"):
    """Check that each recording is what its run was."""


class Report(msgspec.Struct, frozen=True, kw_only=True, tag="report"):
    """Write a report of each recording that excites, with its validation where there is one."""

    folder: str
    """Where the PDFs go, each named as its recording."""
    na: int
    nb: int
    nf: int
    nk: int


Task = Identify | Validate | Verify | Report


def name_of(task: Task) -> str:
    """Return the word by which the command line knows a task."""
    return str(type(task).__struct_config__.tag)


def digest(task: Task) -> str:
    """Return a hash of the task with all its options: results of another one are no results.

    What is None is left out, so that a field that is appended leaves the hash of earlier tasks.
    """
    asked = {name: x for name, x in msgspec.to_builtins(task).items() if x is not None}
    return sha256(msgspec.json.encode(asked, order="sorted").decode())


def sha256(text: str) -> str:
    """Return the hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()
