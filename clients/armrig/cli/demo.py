"""The demonstration: three experiments on an emulated rig, models of the rig, and a report."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from json import dumps
from pathlib import Path
from shlex import quote
from threading import Thread
from typing import TYPE_CHECKING

import typer
from armrig_core.errors import InputError, OperationError
from armrig_core.process.options import preset

import armrig
from armrig.cli.demo_files import demo_files
from armrig.cli.next_step import say_next
from armrig.cli.options import Json
from armrig.cli.printing import columns, fields_of, inform, print_result, spinner
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.excitation.demonstration import DemonstrationRun
    from armrig.report.study import Study

RIG = "demo"
_MAX_S, _MAX_DESCRIBED_S = 600.0, 86_400.0
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


def write_config(directory: Path, seed: int, Ts: float, rig_file: Path | None = None) -> Path:
    """Write the configuration of the demonstration's rig, and return its path."""
    from armrig_core.rig.description import path_of

    path = directory / "armrig.toml"
    paths = (directory, path_of(rig_file) if rig_file else Path())
    # A string of JSON is also one of TOML.
    folder, rig = (dumps(str(path.absolute()), ensure_ascii=False) for path in paths)
    file = f"\nfile = {rig}" if rig_file else ""
    text = _CONFIG.format(rig=RIG, file=file, Ts=Ts, directory=folder, seed=seed)
    path.write_text(text, encoding="utf-8")
    return path


def demo(
    directory: Path = preset(Path("demo"), "Folder for all files."),
    seconds: float | None = preset(
        None,
        "Length of each telegraph signal, in s.",
        "30, with --rig-file a length that suits its model",
        min=5,
    ),
    seed: int = preset(1, "Seed of the inputs and of the rig's noise.", min=0, max=2**63 - 2),
    virtual: bool = preset(
        False, "Run in virtual time, without waiting; the same seed gives the same bytes."
    ),
    firmware: bool = preset(
        False,
        "Run the Uno's firmware in simavr, in virtual time; `make fil` in a checkout "
        "builds the necessary program, which no wheel contains.",
    ),
    rig_file: Path | None = preset(
        None,
        "Description of the rig: a file, or a name of `armrig rigs`.",
        "the arm",
        names="--rig-file TOML",
    ),
    json: Json = False,
) -> None:
    """Emulate a rig, record it, identify models and write a report.

    The demo needs no hardware. It takes two minutes; with --virtual it takes 20 s, on any system
    with Python.

    A repeated demo writes its own files again. A file that is not the demo's, or was changed after
    the demo, is never overwritten: the demo refuses to start.

    With --json the last line contains the paths of all files and the fit of each model.
    """
    from armrig_core.rig.description import builtin, path_of, read_description

    from armrig.excitation.demonstration import experiments
    from armrig.excitation.pace import pace_of

    most = _MAX_S if rig_file is None else _MAX_DESCRIBED_S
    if seconds is not None and seconds > most:
        raise typer.BadParameter(f"--seconds {seconds:g}: 5 to {most:g} s")
    described = read_description(path_of(rig_file)) if rig_file else builtin("arm")
    pace = pace_of(described, seconds)
    plan = experiments(pace, seed)
    paths: list[Path] = []
    virtual = virtual or firmware or not described.arm  # a slow rig needs hours
    with demo_files(directory):
        config = write_config(directory, seed, pace.Ts / pace.every, rig_file)
        why = "" if virtual else _record(plan, config, paths)
        if why:
            inform(f"not in real time: {why}; the demonstration goes on in virtual time")
        n_real = len(paths)
        if n_real < len(plan):
            with spinner("recording in virtual time"):
                # Each experiment of another rig than the arm begins at rest.
                left, folder = plan[n_real:], directory.absolute()
                batches = [left] if described.arm else [[trial] for trial in left]
                for i, batch in enumerate(batches):
                    more = record_in_virtual_time(
                        batch, folder, config, seed + i, firmware=firmware
                    )
                    paths += more
        emulated = _EMULATED if described.arm else _AS_DESCRIBED
        remarks = _remarks(len(paths), n_real, why, emulated) + ([_FIRMWARE] if firmware else [])
        with spinner("identifying and typesetting"):
            done, pdf = _write_report(paths, remarks, directory)
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
    print_result(facts, _text(done, names, directory, pdf), json=json)
    if not json:
        say_next("open", file=quote(str(_from_here(pdf.absolute()))))


def _record(plan: Sequence[DemonstrationRun], config: Path, done: list[Path]) -> str:
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


def _write_report(paths: list[Path], remarks: list[str], directory: Path) -> tuple[Study, Path]:
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
    headings = ("fit of the angle", "fit of the velocity") if done.of_arm else ("fit",)
    models = [("model", "rms error", *headings)]
    for row in done.models:
        fits = (row.fit_percent, row.velocity_fit_percent)[: len(headings)]
        error = f"{row.rms_error:.4g} {done.validation.unit}"
        fit_texts = ("" if fit is None else f"{fit:.2f} %" for fit in fits)
        models.append((row.name, error, *fit_texts))
    files = []
    for recording, name in zip(done.recordings, names, strict=True):
        missing = f", {recording.missing} missing" if recording.missing else ""
        samples = (
            f"{plural(recording.samples.size, 'sample')}{missing}, sha256 {recording.short_hash}"
        )
        files.append((name, f"{_from_here(recording.path)}: {samples}"))
    files += [("figures", str(directory / "*.svg")), ("report", str(pdf))]
    return f"simulated on the validation recording\n{columns(models)}\n\n{columns(files)}"


def _from_here(path: Path) -> Path:
    """Return the path relative to the current folder, if the file is in this folder."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def record_in_virtual_time(
    plan: Sequence[DemonstrationRun],
    directory: Path,
    config: Path,
    seed: int,
    *,
    firmware: bool = False,
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
    requests = (dumps(experiment.of_the_device()) for experiment in plan)
    Thread(target=_load_drawing_modules).start()
    played = subprocess.run(program, input="\n".join(requests).encode(), capture_output=True)
    if played.returncode:
        lines = played.stderr.decode(errors="replace").strip().splitlines()
        raise OperationError(
            lines[-1] if lines else f"armrigd virtual ended with exit code {played.returncode}"
        )
    return [Path(line) for line in played.stdout.decode().splitlines()]
