"""The demonstration: three experiments on an emulated rig, models of the rig, and a report."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from armrig_core.errors import InputError, OperationError
from armrig_core.rig.description import (
    Description,
    path_of,
    read_description,
    require_model,
    shipped,
)
from numpy.typing import NDArray

import armrig
from armrig.cli.printing import columns, fields_of, inform
from armrig.cli.spinner import spinner
from armrig.excitation import step, telegraph

if TYPE_CHECKING:
    from armrig.report.study import Study

RIG = "demo"
LOW, HIGH = 0.5, 4.5
_MAX_TS, _MIN_TS = 1.0, 0.001  # s
_FASTEST, _SLOWEST = 10, 10  # samples in the fastest time constant, slowest ones in an experiment
_SHARE = 0.9  # of the highest voltage, and of the way of an output to its limit
_CONFIG = """\
# Configuration of the demonstration: an emulated rig, sampled at 100 Hz.
[rig]
id = "{rig}"{file}

[device]
watchdog_ms = 250  # the longest: a busy machine stalls the emulator, too

[timing]
Ts = {Ts}

[recording]
directory = {directory}

[emulator]
seed = {seed}
"""
_EMULATED = (
    "The emulated plant obeys the same equations as the physical model below. Its angles are read "
    "through a 10-bit converter with noise and a dead band. The agreement of plant and model shows "
    "that the chain from the converter to the model is right; it shows nothing about a real arm."
)
_AS_DESCRIBED = (
    "The emulated plant obeys the model of its description, and its outputs are read through a "
    "10-bit converter with noise: the results show nothing about a real rig."
)
_VIRTUAL = (
    "{which} made in virtual time: loop, device and recorder are the same programs as in real "
    "time, but do not wait. The dates and times of day are computed from a seed, and the timing "
    "shows nothing about this machine."
)

_FIRMWARE = (
    "The device was the firmware of an Arduino Uno, the same bytes as in a board, in a "
    "simulator of its processor; the voltage was measured at the simulated pin."
)


class Pace(NamedTuple):
    """Sampling time and levels of the demonstration, and the lengths of its experiments, in s."""

    Ts: float = 0.01
    seconds: float = 30.0
    """Length of a telegraph signal."""
    switch: float = 0.05
    """Probability that the telegraph signal switches at a sample."""
    step_s: float = 3.0
    high: float = HIGH
    """Highest voltage of the inputs; the lowest is a ninth of it."""


def pace_of(described: Description, seconds: float | None) -> Pace:
    """Return the pace of a rig, by the time constants and the limits of its model.

    Raises InputError if the description has no model.
    """
    if described.arm:
        return Pace() if seconds is None else Pace(seconds=seconds)
    model, system = require_model(described)
    poles = np.linalg.eigvals(np.array(system.A)).astype(complex)
    rates = np.abs(poles.real if system.Ts is None else np.log(np.abs(poles)) / system.Ts)
    rates = rates[rates > 1e-9] if np.any(rates > 1e-9) else np.ones(1)
    fast, slow = 1 / rates.max(), 1 / rates.min()
    Ts = system.Ts or min(_MAX_TS, max(_MIN_TS, float(f"{fast / _FASTEST:.0e}")))
    return Pace(
        Ts=Ts,
        seconds=seconds or max(30.0, float(np.ceil(_SLOWEST * slow + model.delay_s))),
        switch=float(np.clip(2 * Ts / slow, 0.01, 0.5)),
        step_s=max(3.0, float(np.ceil(5 * slow + 2 * model.delay_s))),
        high=_highest_level(described),
    )


def _highest_level(described: Description) -> float:
    """Return the highest voltage, at most `HIGH`, at which each output stays within its limits."""
    model, system = require_model(described)
    A, B = np.array(system.A), np.array(system.B)
    still = np.linalg.pinv((np.eye(len(A)) if system.Ts else 0.0) - A) @ B
    highest = min(HIGH, _SHARE * described.input.u_max_v)
    rest = model.offset or [0.0] * len(described.outputs)
    gains = (np.array(system.C) @ still)[:, 0]
    for output, gain, y in zip(described.outputs.values(), gains, rest, strict=True):
        room = (output.high if gain > 0 else output.low) - y
        if gain and np.isfinite(room):
            highest = min(highest, _SHARE * room / gain)
    return float(f"{highest:.2g}")


class Experiment(NamedTuple):
    """One run of the demonstration."""

    name: str
    u: NDArray[np.float64]
    """Motor voltage at each sample, in V."""
    request: dict[str, Any]
    """Other fields of the request to the daemon: kind and details."""
    Ts: float = Pace().Ts
    """Sampling time, in s."""

    @property
    def seconds(self) -> float:
        """Length, in s."""
        return self.Ts * self.u.size


def experiments(pace: Pace, seed: int) -> list[Experiment]:
    """Return a step, a telegraph signal, and a telegraph signal for validation."""
    Ts, N = pace.Ts, round(pace.seconds / pace.Ts)
    levels = {"low": pace.high * LOW / HIGH, "high": pace.high}
    up = step(round(pace.step_s / Ts), **levels, at=round(pace.step_s / 6 / Ts))
    asked = {"experiment": "step", "details": {"input": "step", **levels}}
    plan = [Experiment("step", up, asked, Ts)]
    for name, number in (("telegraph", seed), ("validation", seed + 1)):
        details = {"input": "telegraph", **levels, "a": pace.switch, "seed": number}
        u = telegraph(N, pace.switch, **levels, seed=number)
        plan.append(Experiment(name, u, {"experiment": "blackbox", "details": details}, Ts))
    return plan


def write_config(directory: Path, seed: int, Ts: float, rig_file: Path | None = None) -> Path:
    """Write the configuration of the demonstration's rig, and return its path."""
    path = directory / "armrig.toml"
    paths = (directory, path_of(rig_file) if rig_file else Path())
    # A string of JSON is also one of TOML.
    folder, rig = (json.dumps(str(path.absolute()), ensure_ascii=False) for path in paths)
    file = f"\nfile = {rig}" if rig_file else ""
    text = _CONFIG.format(rig=RIG, file=file, Ts=Ts, directory=folder, seed=seed)
    path.write_text(text, encoding="utf-8")
    return path


def demo(
    directory: Path,
    *,
    seconds: float | None,
    seed: int,
    virtual: bool = False,
    firmware: bool = False,
    rig_file: Path | None = None,
) -> tuple[dict[str, Any], str]:
    """Record an emulated rig, identify and validate models, and write a report to `directory`.

    Returns the results and the paths of the files as JSON fields, and as text.

    If the machine stalls too often in real time, the remaining experiments are recorded in virtual
    time. If they cannot be recorded in virtual time either, an OperationError is raised.
    `firmware` needs `virtual`. `rig_file` describes the rig, by default the arm; another rig is
    recorded in virtual time.
    """
    described = read_description(path_of(rig_file)) if rig_file else shipped("arm")
    pace = pace_of(described, seconds)
    plan = experiments(pace, seed)
    directory.mkdir(parents=True, exist_ok=True)
    config = write_config(directory, seed, pace.Ts, rig_file)
    paths: list[Path] = []
    virtual = virtual or not described.arm  # a slow rig needs hours
    why = "" if virtual else _record(plan, config, paths)
    if why:
        inform(f"not in real time: {why}; the demonstration goes on in virtual time")
    n_real = len(paths)
    if n_real < len(plan):
        with spinner("recording in virtual time"):
            folder = directory.absolute()
            paths += record_in_virtual_time(plan[n_real:], folder, config, seed, firmware=firmware)
    emulated = _EMULATED if described.arm else _AS_DESCRIBED
    remarks = _remarks(len(paths), n_real, why, emulated) + ([_FIRMWARE] if firmware else [])
    with spinner("identifying and typesetting"):
        done, pdf = _reported(paths, remarks, directory)
    if not virtual:
        inform(f"the daemon's log: {directory / 'armrigd.log'}")
    names = [experiment.name for experiment in plan]
    errors = "rms_error fit_percent velocity_fit_percent"
    facts = {
        "recordings": dict(zip(names, map(str, paths), strict=True)),
        "in_virtual_time": names[n_real:],
        "models": [{"model": row.name} | fields_of(row, errors) for row in done.models],
        "figures": sorted(map(str, directory.absolute().glob("*.svg"))),
        "report": str(pdf.absolute()),
    }
    return facts, _text(done, names, directory, pdf)


def _record(plan: list[Experiment], config: Path, done: list[Path]) -> str:
    """Append real-time recordings to `done`; return why some are missing, or "" if none is."""
    if sys.platform != "linux":
        return "emulation in real time needs Linux"
    from armrig.cli.demo_rig import record_in_real_time

    try:
        record_in_real_time(plan, RIG, config, done)
    except (armrig.RigError, InputError) as err:  # InputError: no folder for the daemon's socket
        return str(err)
    return ""


def _load_drawing_modules() -> None:
    """Import slow modules while another processor plays the experiments."""
    from armrig.recordings.files import loading  # noqa: F401
    from armrig.report import document  # noqa: F401


def _reported(paths: list[Path], remarks: list[str], directory: Path) -> tuple[Study, Path]:
    """Return the study of the recordings, and the path of its report with these remarks."""
    from armrig.report.document import report
    from armrig.report.study import study

    done = study([armrig.load(path) for path in paths])
    return done, report(done, directory / "report.pdf", remarks=remarks, figures=directory)


def _remarks(n: int, n_real: int, why: str, emulated: str = _EMULATED) -> list[str]:
    """Return the report's remarks on `n` recordings; the first `n_real` are in real time."""
    if n_real == n:
        return [emulated]
    which = f"The last {n - n_real} of the recordings were" if n_real else "All recordings were"
    virtual = _VIRTUAL.format(which=which)
    if why:
        virtual += f" This machine could not emulate the rig in real time: {why}."
    return [emulated, virtual]


def _text(done: Study, names: list[str], directory: Path, pdf: Path) -> str:
    """Return the errors of the models on the validation recording, and the names of the files."""
    of = ("fit of the angle", "fit of the velocity") if done.of_arm else ("fit",)
    models = [("model", "rms error", *of)]
    for row in done.models:
        fits = (row.fit_percent, row.velocity_fit_percent)[: len(of)]
        error = f"{row.rms_error:.4g} {done.validation.unit}"
        shown = ("" if fit is None else f"{fit:.2f} %" for fit in fits)
        models.append((row.name, error, *shown))
    files = []
    for recording, name in zip(done.recordings, names, strict=True):
        missing = f", {recording.missing} missing" if recording.missing else ""
        samples = f"{recording.samples.size} samples{missing}, sha256 {recording.short_hash}"
        files.append((name, f"{from_here(recording.path)}: {samples}"))
    files += [("figures", str(directory / "*.svg")), ("report", str(pdf))]
    return f"simulated on the validation recording\n{columns(models)}\n\n{columns(files)}"


def from_here(path: Path) -> Path:
    """Return the path relative to the current folder, if the file is in this folder."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def record_in_virtual_time(
    plan: Sequence[Experiment], directory: Path, config: Path, seed: int, *, firmware: bool = False
) -> list[Path]:
    """Play experiments on an emulated rig in virtual time; return their recordings.

    The seed determines the emulated rig, and the names and times of its recordings. With
    `firmware`, the device is the Uno's firmware in simavr. If the experiments cannot be recorded,
    an OperationError is raised.
    """
    # UTF-8 on any host, for the names of folders in the pipes.
    program = [sys.executable, "-X", "utf8", "-m", "armrig_daemon", "virtual"]
    program += ["--config", str(config), "--directory", str(directory), "--seed", str(seed)]
    program += ["--firmware"] if firmware else []
    requests = (json.dumps({"u": one.u.tolist(), **one.request}) for one in plan)
    Thread(target=_load_drawing_modules).start()
    played = subprocess.run(program, input="\n".join(requests).encode(), capture_output=True)
    if played.returncode:
        lines = played.stderr.decode(errors="replace").strip().splitlines()
        raise OperationError(
            lines[-1] if lines else f"armrigd virtual ended with exit code {played.returncode}"
        )
    return [Path(line) for line in played.stdout.decode().splitlines()]
