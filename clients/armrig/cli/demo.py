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
from numpy.typing import NDArray

import armrig
from armrig.cli.printing import columns, fields_of, inform
from armrig.cli.spinner import spinner
from armrig.excitation import step, telegraph

if TYPE_CHECKING:
    from armrig.report.study import Study

RIG = "demo"
Ts = 0.01
LOW, HIGH, SWITCH = 0.5, 4.5, 0.05
_STEP_S, _STEP_AT_S = 3.0, 0.5
_CONFIG = """\
# Configuration of the demonstration: an emulated rig, sampled at 100 Hz.
[rig]
id = "{rig}"

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
_VIRTUAL = (
    "{which} made in virtual time: loop, device and recorder are the same programs as in real "
    "time, but do not wait. The dates and times of day are computed from a seed, and the timing "
    "shows nothing about this machine."
)

_FIRMWARE = (
    "The device was the firmware of an Arduino Uno, the same bytes as in a board, in a "
    "simulator of its processor; the voltage was measured at the simulated pin."
)


class Experiment(NamedTuple):
    """One run of the demonstration."""

    name: str
    u: NDArray[np.float64]
    """Motor voltage at each sample, in V."""
    request: dict[str, Any]
    """Other fields of the request to the daemon: kind and details."""

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""
        return Ts

    @property
    def seconds(self) -> float:
        """Length, in s."""
        return Ts * self.u.size


def experiments(seconds: float, seed: int) -> list[Experiment]:
    """Return a step, a telegraph signal of `seconds`, and a telegraph signal for validation."""
    N = round(seconds / Ts)
    levels = {"low": LOW, "high": HIGH}
    up = step(round(_STEP_S / Ts), **levels, at=round(_STEP_AT_S / Ts))
    plan = [Experiment("step", up, {"experiment": "step", "details": {"input": "step", **levels}})]
    for name, number in (("telegraph", seed), ("validation", seed + 1)):
        details = {"input": "telegraph", **levels, "a": SWITCH, "seed": number}
        u = telegraph(N, SWITCH, LOW, HIGH, seed=number)
        plan.append(Experiment(name, u, {"experiment": "blackbox", "details": details}))
    return plan


def write_config(directory: Path, seed: int) -> Path:
    """Write the configuration of the demonstration's rig, and return its path."""
    path = directory / "armrig.toml"
    folder = json.dumps(str(directory.absolute()), ensure_ascii=False)  # also a string of TOML
    text = _CONFIG.format(rig=RIG, Ts=Ts, directory=folder, seed=seed)
    path.write_text(text, encoding="utf-8")
    return path


def demo(
    directory: Path,
    *,
    seconds: float,
    seed: int,
    virtual: bool = False,
    firmware: bool = False,
) -> tuple[dict[str, Any], str]:
    """Record an emulated rig, identify and validate models, and write a report to `directory`.

    Returns the results and the paths of the files as JSON fields, and as text.

    If the machine stalls too often in real time, the remaining experiments are recorded in virtual
    time. If they cannot be recorded in virtual time either, an OperationError is raised.
    `firmware` needs `virtual`.
    """
    directory.mkdir(parents=True, exist_ok=True)
    config, plan = write_config(directory, seed), experiments(seconds, seed)
    paths: list[Path] = []
    why = "" if virtual else _record(plan, config, paths)
    if why:
        inform(f"not in real time: {why}; the demonstration goes on in virtual time")
    n_real = len(paths)
    if n_real < len(plan):
        with spinner("recording in virtual time"):
            folder = directory.absolute()
            paths += record_in_virtual_time(plan[n_real:], folder, config, seed, firmware=firmware)
    remarks = _remarks(len(paths), n_real, why) + ([_FIRMWARE] if firmware else [])
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


def _remarks(n: int, n_real: int, why: str) -> list[str]:
    """Return the report's remarks on `n` recordings; the first `n_real` are in real time."""
    if n_real == n:
        return [_EMULATED]
    which = f"The last {n - n_real} of the recordings were" if n_real else "All recordings were"
    virtual = _VIRTUAL.format(which=which)
    if why:
        virtual += f" This machine could not emulate the rig in real time: {why}."
    return [_EMULATED, virtual]


def _text(done: Study, names: list[str], directory: Path, pdf: Path) -> str:
    """Return the errors of the models on the validation recording, and the names of the files."""
    models = [("model", "rms error", "fit of the angle", "fit of the velocity")]
    for row in done.models:
        velocity = row.velocity_fit_percent
        fit = "" if velocity is None else f"{velocity:.2f} %"
        error = f"{row.rms_error:.4g} {done.validation.unit}"
        models.append((row.name, error, f"{row.fit_percent:.2f} %", fit))
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
