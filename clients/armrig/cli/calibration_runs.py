"""The steps of a calibration: questions to the user, a recording at rest, and slow turns."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import platformdirs
import typer
from armrig_core.errors import InputError
from armrig_core.rig.calibration_file import raw_path

from armrig.cli.next_step import say_to_copy
from armrig.cli.printing import inform, question

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording


_OWNER = "armrig calibrate"
_DEAD_MAN_S = 1.0
_MAX_LEVEL_S = 600.0
_START_S = 0.5  # time at 0 V before the turns, to read the arm at rest
_QUESTION = "Load the calibration into the running daemon now?"


class Dialogue:
    """Questions to the user at the terminal; if `yes` is True, there are no questions."""

    def __init__(self, *, yes: bool) -> None:
        self._quiet = yes

    def ready(self, text: str) -> None:
        """Print an instruction, and wait until the user confirms that it was followed."""
        if not self._quiet:
            _prompt(f"{text} Then press Enter")

    def has_meter(self) -> bool:
        """Ask, before the motor turns, whether a voltmeter is connected to the motor."""
        text = "Is a voltmeter at the motor's terminals? If yes, note its reading at each voltage"
        return not self._quiet and typer.confirm(question(text), default=False, err=True)

    def meter(self, levels: Sequence[float]) -> list[tuple[int, float]]:
        """Ask for the voltmeter's reading at each level; return pairs (PWM code, reading in V)."""
        from armrig_core.rig.volts import code_of

        readings: list[tuple[int, float]] = []
        for u in levels:
            if shown := _prompt(f"Reading of the meter at {u:g} V, in V (Enter: none)"):
                readings.append(meter_reading(f"{code_of(u)}={shown}"))
        return readings


def _prompt(text: str) -> str:
    return str(typer.prompt(question(text), default="", show_default=False, err=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Player:
    """Player of the runs of a calibration; each method returns the recording of its run."""

    Ts: float | None
    rig: str
    connect: str | None

    def rest(self, experiment: str, seconds: float) -> Recording:
        """Record the rig at 0 V."""
        import numpy as np

        return self._played(experiment, seconds, {}, lambda N, _: np.zeros(N))

    def turns(self, levels: Sequence[float], level_seconds: float) -> Recording:
        """Record the rig while it turns at the given voltages, one after another."""
        import numpy as np

        seconds = _START_S + level_seconds * len(levels)

        def make(N: int, Ts: float) -> Any:
            t = np.arange(N) * Ts - _START_S
            at = np.minimum((t / level_seconds).astype(int), len(levels) - 1)
            return np.where(t < 0, 0.0, np.array(levels)[at])

        details = {"levels": list(levels), "level_seconds": level_seconds}
        return self._played("calibrate-turns", seconds, details, make)

    def _played(
        self,
        experiment: str,
        seconds: float,
        details: Mapping[str, Any],
        make: Callable[[int, float], Any],
    ) -> Recording:
        from armrig.recordings.loading import load
        from armrig.rig.collection import Plan, collect

        plan = Plan(
            experiment=experiment,
            make=make,
            details=details,
            seconds=seconds,
            Ts=self.Ts,
            pacing="scheduled",
            owner=_OWNER,
            dead_man=_DEAD_MAN_S,
        )
        return load(collect(plan, rig=self.rig, connect=self.connect, tell=inform).path)


def check_turns(levels: Sequence[float], level_seconds: float) -> None:
    """Refuse voltages outside the rig's range, and times too short for a steady speed."""
    from armrig_core.rig.volts import U_MAX_V

    from armrig.recordings.calibration_turns import LEAST_S, SETTLE_S

    for u in levels:
        if not 0 < u <= U_MAX_V:
            raise InputError(f"--volts {u:g}: must be more than 0 and at most {U_MAX_V:g} V")
    if not SETTLE_S + LEAST_S < level_seconds <= _MAX_LEVEL_S:
        raise InputError(
            f"--level-seconds {level_seconds:g}: must be more than {SETTLE_S + LEAST_S:g} s and at "
            f"most {_MAX_LEVEL_S:g} s; the first {SETTLE_S:g} s are not used"
        )


def meter_reading(text: str) -> tuple[int, float]:
    """Return the PWM code and the voltmeter's reading, in V, from a text CODE=VOLTS."""
    from armrig_protocol.messages import CODE_FULL_SCALE

    code, _, volts = text.partition("=")
    try:
        reading = int(code), float(volts)
    except ValueError:
        reading = 0, 0.0
    if not 0 < reading[0] <= CODE_FULL_SCALE or not 0 < reading[1] <= 10:
        raise InputError(
            f"--meter {text}: must be CODE=VOLTS, a code of 1 to {CODE_FULL_SCALE} and a reading, "
            "such as 32768=2.49"
        )
    return reading


def take_into_use(
    path: Path, *, wanted: bool | None, asks: bool, rig: str, connect: str | None
) -> bool:
    """Load a calibration into the running daemon if wanted; return True if it is in use.

    If `wanted` is None and a daemon runs, the user is asked. Without `asks`, the calibration is
    then loaded without a question.

    Raises
    ------
    RigError
        The daemon refuses the calibration, or does not answer although `wanted` is True.
    """
    from armrig.rig.client import Rig
    from armrig.rig.replies import RefusedError, refusal_sentence, reset_command
    from armrig.rig.session import NoReplyError, RigError

    named, is_used = "", False
    try:
        with Rig(rig, connect=connect) as opened:
            named = opened.status().calibration_file
            is_used = _is_wanted(wanted, asks=asks)
            if is_used:
                opened.calibrate(path)
    except RefusedError as err:
        why = refusal_sentence(err, reset_command(rig, connect))
        raise RigError(f"{path} is written, but not in use: {why}") from err
    except NoReplyError:
        if wanted:
            raise
        is_used = False
        inform(f"not in use: no daemon of rig {rig} answers")
    if is_used:
        inform(
            f"rig {rig} uses the calibration from the next sample on, until `armrig lab` or "
            "armrigd ends"
        )
    _say_how_it_stays(path, named)
    return is_used


def _is_wanted(wanted: bool | None, *, asks: bool) -> bool:
    """Return True if the daemon must load the calibration; if not, print that it is not in use."""
    if wanted is None and asks and not sys.stdin.isatty():
        inform("not in use: --use loads the calibration into the running daemon")
        return False
    if wanted is None:
        wanted = not asks or typer.confirm(_QUESTION, default=True, err=True)
    if not wanted:
        inform("not in use")
    return wanted


def _say_how_it_stays(path: Path, named: str) -> None:
    """Print what the user must do so that the daemon uses the calibration after its next start.

    `named` is the calibration file in the configuration of the running daemon.
    """
    path = path.absolute()
    if named == str(path):
        inform("armrigd reads this file at its next start, too")
        return
    if named:
        pairs = [(path, Path(named)), (raw_path(path), raw_path(Path(named)))]
        copies = [f"cp {quote(str(a))} {quote(str(b))}" for a, b in pairs]
        inform(f"armrigd reads {named} at its next start; to replace that file:")
        say_to_copy(" && ".join(copies))
        return
    configuration = Path(platformdirs.user_config_dir("armrig")) / "armrig.toml"
    name = path.name if path.parent == configuration.parent else str(path)
    inform(f"to use the calibration from the next start of armrigd on, add to {configuration}:")
    say_to_copy(f"[calibration]\nfile = {json.dumps(name, ensure_ascii=False)}")
