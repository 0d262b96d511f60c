"""The demonstration: emulator and daemon as processes of their own, three recordings, a report."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.commands import StatusReport
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from armrig.excitation import step, telegraph
from armrig.recordings.loading import load
from armrig.recordings.recording import Recording
from armrig.report.document import report
from armrig.report.figures import write_figures
from armrig.report.study import Study, study
from armrig.rig.client import BusyError, RefusedError, Rig, RunEndedError
from armrig.rig.progress import bar, timing_note
from armrig.rig.realtime_status import scheduling_sentences
from armrig.rig.session import NoReplyError, RigError

RIG = "demo"
Ts = 0.01
LOW, HIGH, SWITCH = 0.5, 4.5, 0.05
_STEP_S, _STEP_AT_S = 3.0, 0.5
_START_S, _STOP_S = 15.0, 5.0
_RETRY_UNTIL_S = 165.0  # three minutes, less the report
_EMULATED = (
    "The rig was emulated: its plant obeys the same equations as the physical model below, read "
    "through a 10-bit converter with noise and a dead band. That the two agree says that the chain "
    "from the converter to the model is right, and nothing of a real arm."
)
_CONFIG = """\
# The demonstration's: an emulated rig, sampled at 100 Hz.
[rig]
id = "{rig}"

[device]
watchdog_ms = 250  # the longest: a busy machine stalls the emulator, too

[timing]
Ts = {Ts}

[recording]
directory = "{directory}"
"""


def demo(directory: Path, *, seconds: float = 30.0, console: Console | None = None) -> None:
    """Record an emulated rig, identify and validate it, and write a report into `directory`.

    Raises
    ------
    RigError
        The daemon does not start, or a run ends early.
    """
    console = console or Console()
    directory.mkdir(parents=True, exist_ok=True)
    N = round(seconds / Ts)
    plan = (
        ("step", step(round(_STEP_S / Ts), low=LOW, high=HIGH, at=round(_STEP_AT_S / Ts)), None),
        ("blackbox", telegraph(N, SWITCH, LOW, HIGH, seed=1), 1),
        ("blackbox", telegraph(N, SWITCH, LOW, HIGH, seed=2), 2),
    )
    recordings: list[Recording] = []
    began = time.monotonic()
    left_s = Ts * sum(u.size for _, u, _ in plan)
    with running(directory, console), Rig(RIG) as rig:
        for line in scheduling_sentences(rig.status().host):
            console.print(f"  {line}", highlight=False, markup=False)
        for (experiment, u, seed), name in zip(
            plan, ("step", "telegraph", "validation"), strict=True
        ):
            details = {"input": "step" if seed is None else "telegraph", "low": LOW, "high": HIGH}
            details |= {} if seed is None else {"a": SWITCH, "seed": seed}
            request = {"experiment": experiment, "details": details}
            retry_until = began + _RETRY_UNTIL_S - left_s
            recordings.append(load(_recorded(rig, u, request, name, console, retry_until)))
            left_s -= Ts * u.size
    with console.status("identifying and typesetting"):
        done = study(recordings)
        pdf = report(done, directory / "report.pdf", remarks=[_EMULATED])
        write_figures(done, directory)
    _print_results(console, done, directory, pdf)


def _recorded(
    rig: Rig,
    u: NDArray[np.float64],
    request: dict[str, Any],
    name: str,
    console: Console,
    retry_until: float,
) -> Path:
    """Arm and run `u`; where a busy machine has held up the emulator, say so and run once more."""
    while True:
        wait_for_phase(rig, "safe")
        try:
            rig.arm("armrig demo", Ts)
            with (
                timing_note(rig) as note,
                bar(name, console, note=note) as progress,
            ):
                return rig.run(u, progress=progress, **request)
        except (RunEndedError, RefusedError) as err:
            has_tripped = rig.status().phase == "fault"
            if not (has_tripped or isinstance(err, RunEndedError | BusyError)):
                raise
            if time.monotonic() > retry_until:
                msg = f"{err}; this machine is too busy for an emulated rig: end other programs "
                msg += "(`armrig doctor` says what costs), then try again"
                raise RigError(msg) from err
            console.print(f"  {err}; once more", highlight=False, markup=False, soft_wrap=True)
            if has_tripped:
                rig.reset()
            else:
                rig.stop()  # gives back a rig that is still armed


def wait_for_phase(rig: Rig, phase: str) -> StatusReport:
    """Return the status once the daemon is in `phase`."""
    until = time.monotonic() + _START_S
    while (status := rig.status()).phase != phase:
        if time.monotonic() > until:
            msg = f"rig {rig.rig} is {status.phase} {status.reason}, not {phase}, after "
            msg += f"{_START_S:g} s; look at the daemon's log"
            raise RigError(msg)
        time.sleep(0.05)
    return status


@contextmanager
def running(directory: Path, console: Console) -> Iterator[None]:
    """Run the daemon on an emulated rig, and stop it whatever happens."""
    config, log = directory / "armrig.toml", directory / "armrigd.log"
    text = _CONFIG.format(rig=RIG, Ts=Ts, directory=_toml(directory.absolute()))
    config.write_text(text, encoding="utf-8")
    program = [sys.executable, "-m", "armrig_daemon", "run", "--config", str(config), "--emulate"]
    with log.open("wb") as output:
        # A session of its own: Ctrl-C is ours, and we stop it in order.
        daemon = subprocess.Popen(
            program, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
        try:
            ready = _wait_until_ready(daemon, log)
            console.print(f"daemon and emulator run: rig {RIG} at {ready.endpoint}", markup=False)
            yield
        finally:
            stop(daemon)


def stop(daemon: subprocess.Popen[bytes]) -> None:
    """Ask the daemon to end, which brings the motor to 0 V; kill it where it does not."""
    if daemon.poll() is not None:
        return
    daemon.send_signal(signal.SIGTERM)
    try:
        daemon.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()


def _wait_until_ready(daemon: subprocess.Popen[bytes], log: Path) -> StatusReport:
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        if daemon.poll() is not None:
            lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            msg = f"the daemon ended with exit code {daemon.returncode}: "
            msg += lines[-1] if lines else f"it said nothing in {log}"
            raise RigError(msg)
        try:
            with Rig(RIG) as rig:
                status = rig.status()
            if status.phase == "safe":
                return status
        except NoReplyError:
            pass  # not yet
        time.sleep(0.1)
    msg = f"the daemon is not ready after {_START_S:g} s; see {log}"
    raise RigError(msg)


def _print_results(console: Console, done: Study, directory: Path, pdf: Path) -> None:
    models = Table(title="simulated on the validation recording", title_justify="left")
    for heading in ("model", "rms error", "fit of the angle", "fit of the velocity"):
        models.add_column(heading, justify="left" if heading == "model" else "right")
    for row in (model.comparison for model in done.models):
        velocity = row.velocity_fit_percent
        models.add_row(
            row.name,
            f"{row.rms_error:.4g} {done.validation.unit}",
            f"{row.fit_percent:.2f} %",
            "" if velocity is None else f"{velocity:.2f} %",
        )
    console.print(models)
    where = Table(title="where everything lies", title_justify="left", show_header=False)
    for recording, name in zip(done.recordings, ("step", "telegraph", "validation"), strict=True):
        missing = f", {recording.missing} missing" if recording.missing else ""
        samples = f"{recording.samples.size} samples{missing}, sha256 {recording.short_hash}"
        where.add_row(name, f"{escape(str(_from_here(recording.path)))}\n[dim]{samples}[/dim]")
    where.add_row("figures", escape(str(directory / "*.svg")))
    where.add_row("daemon's log", escape(str(directory / "armrigd.log")))
    where.add_row("report", f"[bold]{escape(str(pdf))}[/bold]")
    console.print(where)


def _from_here(path: Path) -> Path:
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def _toml(path: Path) -> str:
    return str(path).replace("\\", "\\\\").replace('"', '\\"')
