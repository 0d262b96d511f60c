"""The command that calibrates a rig from a recording at rest, slow turns and a voltmeter."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import islice, pairwise
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import platformdirs
import typer
from armrig_core.errors import FileError, InputError
from armrig_core.process.options import group, preset
from armrig_core.rig.calibration import ALPHA
from armrig_core.rig.calibration_file import raw_path
from armrig_core.rig.channels import check_points

import armrig
from armrig.cli.next_step import option_for_rig, say_next, say_to_copy
from armrig.cli.options import Connect, Json, RigId, SamplingTime
from armrig.cli.printing import fields_of, inform, print_json, print_table, question, tell
from armrig.cli.recorded_data import recording_path
from armrig.cli.results import Plot, check_plot, write_plot
from armrig.numerics.quantities import with_std

if TYPE_CHECKING:
    from armrig_core.rig.calibration import Calibration

    from armrig.physics.calibration import CalibrationEstimate

_OWNER = "armrig calibrate"
_DEAD_MAN_S = 1.0
_MAX_LEVEL_S = 600.0
_MIN_COUNTS = 640  # ten steps of a converter of 10 bits
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
            if reading := _prompt(f"Reading of the meter at {u:g} V, in V (Enter: none)"):
                readings.append(meter_reading(f"{code_of(u)}={reading}"))
        return readings


def _prompt(text: str) -> str:
    return str(typer.prompt(question(text), default="", show_default=False, err=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Player:
    """Player of the runs of a calibration; each method returns the recording of its run."""

    Ts: float | None
    rig: str
    connect: str | None

    def rest(self, experiment: str, seconds: float) -> armrig.Recording:
        """Record the rig at 0 V."""
        import numpy as np

        return self._record(experiment, seconds, make=lambda N, _: np.zeros(N), details={})

    def turns(self, levels: Sequence[float], level_seconds: float) -> armrig.Recording:
        """Record the rig while it turns at the given voltages, one after another."""
        import numpy as np

        def make(N: int, Ts: float) -> Any:
            t = np.arange(N) * Ts - _START_S
            at = np.minimum((t / level_seconds).astype(int), len(levels) - 1)
            return np.where(t < 0, 0.0, np.array(levels)[at])

        seconds = _START_S + level_seconds * len(levels)
        details = {"levels": list(levels), "level_seconds": level_seconds}
        return self._record("calibrate-turns", seconds, make=make, details=details)

    def _record(self, experiment: str, seconds: float, **of_input: Any) -> armrig.Recording:
        from armrig.rig.collection import Plan, collect

        of_run: dict[str, Any] = {"owner": _OWNER, "pacing": "scheduled", "dead_man": _DEAD_MAN_S}
        of_run["of_arm"] = True
        plan = Plan(experiment=experiment, seconds=seconds, Ts=self.Ts, **of_run, **of_input)
        return armrig.load(collect(plan, rig=self.rig, connect=self.connect, tell=inform).path)


def check_turns(levels: Sequence[float], level_seconds: float) -> None:
    """Refuse voltages outside the rig's range, and times too short for a steady speed."""
    from armrig_core.rig.volts import U_MAX_V

    from armrig.physics.calibration_turns import LEAST_S, SETTLE_S

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


def _take_into_use(
    path: Path, *, wanted: bool | None, asks: bool, rig: str, connect: str | None
) -> bool:
    """Load a calibration into the running daemon if the user wants it; return True if in use."""
    from armrig.cli.rig import open_rig
    from armrig.rig.replies import RefusedError
    from armrig.rig.session import NoReplyError

    named, is_used = "", False
    try:
        with open_rig(rig, connect) as opened:
            named = opened.status().calibration_file
            is_used = _is_wanted(wanted, asks=asks)
            if is_used:
                opened.calibrate(path)
    except RefusedError as err:
        raise armrig.RigError(f"{path} is written, but not in use: {err}") from err
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
    """Print how to use the calibration after the next start; `named` is the configured file."""
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


_DEFAULT_LEVELS_V = (1.0, 2.0, 3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _MeasurementPlan:
    """Measurements to make, and earlier measurements."""

    volts: list[float] | None = preset(None, "Voltage to apply, in V; repeatable.", "1, 2 and 3")
    level_seconds: float = preset(12.0, "Time for which each voltage is held, in s.")
    rest_seconds: float = preset(
        3.0, "Length of the recordings at rest and with the arm deflected, in s."
    )
    meter: list[str] | None = preset(
        None,
        "Voltmeter's reading at the motor for a PWM code, 1 to 65535; repeatable.",
        metavar="CODE=VOLTS",
    )
    point: list[str] | None = preset(
        None,
        "Known value of an output that does not turn, in its unit; give two values of one output, "
        "or more if it is not linear.",
        metavar="NAME=VALUE",
    )
    meter_std: float = preset(0.01, "Standard deviation of a meter's reading, in V.")
    by_hand: bool = preset(
        False, "Leave the motor off; deflect the arm by hand to find the sign of its angle."
    )
    rest_file: Path | None = preset(
        None, "Earlier recording of the rig at rest.", names="--rest F", parser=recording_path
    )
    turns_file: Path | None = preset(
        None, "Earlier recording of the slow turns.", names="--turns F", parser=recording_path
    )

    def __post_init__(self) -> None:
        """Refuse a wrong reading of the voltmeter."""
        _ = self.readings

    @property
    def levels(self) -> list[float]:
        """Voltages of the turns, in V."""
        return self.volts or list(_DEFAULT_LEVELS_V)

    @property
    def readings(self) -> list[tuple[int, float]]:
        """PWM codes, each with the voltmeter's reading in V."""
        return [meter_reading(text) for text in self.meter or []]


def calibrate(
    *,
    plot: Plot = None,
    save: Path | None = preset(
        None,
        "Calibration file to write.",
        "calibration-<rig>.toml in ~/.config/armrig",
        metavar="TOML",
    ),
    wanted: Annotated[_MeasurementPlan, group(_MeasurementPlan)],
    Ts: SamplingTime = None,
    yes: bool = preset(
        False,
        "Ask no question, not even for meter readings. The daemon uses the calibration unless "
        "--no-use is given.",
    ),
    use: bool | None = preset(
        None,
        "Use the calibration in the running daemon until the daemon ends.",
        "the command asks",
        names="--use/--no-use",
    ),
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Calibrate the potentiometers and the motor, step by step.

    Each number is printed with its standard deviation.
    """
    from armrig_core.rig.calibration import Calibration

    from armrig.physics.calibration import estimate
    from armrig.recordings.files.origin import Origin

    if wanted.point:
        _measure_points(wanted, Dialogue(yes=yes), rig, connect, json=json)
        return
    path = _writable_path(save or _default(rig))
    _check_figure(plot, wanted)
    check_turns(wanted.levels, wanted.level_seconds)
    _check_terminal(wanted, yes=yes)
    play = Player(Ts=Ts, rig=rig, connect=connect)
    recordings, readings = _measure(wanted, Dialogue(yes=yes), play)
    rest_recording, turns = recordings["rest"], recordings.get("turns")
    # The calibration of the recording at rest supplies the values that are not measured.
    base = rest_recording.calibration or Calibration()
    estimates = estimate(
        rest_recording,
        turns,
        deflected=recordings.get("deflected"),
        meter=[(_device_volts(code, rest_recording), reading) for code, reading in readings],
        meter_std_v=wanted.meter_std,
        base=base,
    )
    _write(path, estimates, base, recordings)
    if turns is not None:
        write_plot(plot, calibration=partial(estimates.plot, turns), height=6.0)
    for warning in estimates.warnings:
        tell(warning)
    figures = estimates.figures()
    if not json:
        sign = {1: "grows with the counts", -1: "falls with the counts", 0: "not seen"}
        rows = ((name, with_std(figure.value, figure.std)) for name, figure in figures.items())
        print_table(*rows, (ALPHA, sign[estimates.alpha_sign]), ("calibration", str(path)))
    used = _take_into_use(path, wanted=use, asks=not yes, rig=rig, connect=connect)
    if json:
        facts = {"calibration": path, "figures": figures}
        print_json(facts | fields_of(estimates, "alpha_sign warnings") | {"in_use": used})
    else:
        # No earlier recording has the new calibration.
        made = hashlib.sha256(path.read_bytes()).hexdigest()
        origin = Origin.of_run(rest_recording.path, rest_recording.manifest).with_calibration(made)
        say_next("collect step", origin, rig=option_for_rig(rig, connect))


def _measure_points(
    wanted: _MeasurementPlan, ask: Dialogue, rig: str, connect: str | None, *, json: bool
) -> None:
    """Measure the readings at values of an output; print the lines for the description."""
    points = [point.partition("=") for point in wanted.point or []]
    with armrig.Rig(rig, connect=connect) as opened:
        status = opened.status()
        described = status.described
        name = points[0][0]
        is_one = all(other == name for other, *_ in points) and name in described.outputs
        if len(points) < 2 or not is_one:
            raise InputError(
                "--point: give two values of one output, or more, such as --point NAME=1.5 "
                f"--point NAME=3; the rig has {', '.join(described.outputs)}"
            )
        try:
            values = [float(value) for *_, value in points]
        except ValueError:
            raise InputError(f"--point {name}: give a number after =") from None
        channel, unit = [*described.outputs].index(name), described.outputs[name].unit
        counts = []
        for value in values:
            ask.ready(f"Bring {name} to {value:g} {unit} and hold it.")
            n = max(2, round(wanted.rest_seconds / status.Ts))
            some = islice((s for s in opened.stream() if not isinstance(s, armrig.LiveGap)), n)
            counts.append(sum((s.counts_0, s.counts_1)[channel] for s in some) / n)
    try:
        conversion = conversion_through(sorted(zip(counts, values, strict=True)))
    except InputError as err:
        raise InputError(f"--point {name}: {err}") from err
    if json:
        print_json({"output": name} | conversion)
        return
    inform("put these lines into the description of the rig:")
    lines = (
        f"{key} = {x if key == 'points' else format(x, '.6g')}" for key, x in conversion.items()
    )
    say_to_copy("\n".join([f"[outputs.{name}]", *lines]))


def conversion_through(points: Sequence[tuple[float, float]]) -> dict[str, Any]:
    """Return the keys of an output's conversion through pairs of counts and value.

    Raises InputError if the readings are too close, or are no function with an inverse.
    """
    if any(b[0] - a[0] < _MIN_COUNTS or a[1] == b[1] for a, b in pairwise(points)):
        readings = " and ".join(f"{counts:.0f}" for counts, _ in points)
        raise InputError(
            f"the readings are {readings} counts; give values that are further apart, and "
            "check the "
            "wires"
        )
    check_points(points)
    if len(points) > 2:
        return {"points": [[round(counts, 1), value] for counts, value in points]}
    (left, low), (right, high) = points
    per_count = (high - low) / (right - left)
    return {"zero_counts": left - low / per_count, "per_count": per_count}


def _measure(
    wanted: _MeasurementPlan, ask: Dialogue, play: Player
) -> tuple[dict[str, armrig.Recording], list[tuple[int, float]]]:
    """Return the recordings by name, and the voltmeter's readings; make those without a file."""
    files = {"rest": wanted.rest_file, "turns": wanted.turns_file}
    recordings = {name: armrig.load(path) for name, path in files.items() if path is not None}
    for recording in recordings.values():
        if not recording.description.arm:
            name = recording.first
            raise InputError(
                f"{recording.name} is of the rig '{recording.description.title}', and --rest and "
                f"--turns are for the arm: use `armrig calibrate --point {name}=A --point {name}=B`"
            )
    readings, seconds = wanted.readings, wanted.level_seconds
    if "rest" not in recordings:
        ask.ready("Turn the chassis to its mark for theta_1 = 0 and let the arm hang still.")
        recordings["rest"] = play.rest("calibrate-rest", wanted.rest_seconds)
    if wanted.by_hand:
        ask.ready(
            "Deflect the arm in the direction in which a voltage turns the chassis, and hold it "
            f"for {wanted.rest_seconds:g} s."
        )
        recordings["deflected"] = play.rest("calibrate-hand", wanted.rest_seconds)
    elif "turns" not in recordings:
        text = ", ".join(f"{v:g} V" for v in wanted.levels)
        with_meter = not readings and ask.has_meter()
        ask.ready(f"The chassis will turn at {text}, {seconds:g} s each: keep your hands away.")
        recordings["turns"] = play.turns(wanted.levels, seconds)
        if with_meter:
            readings = ask.meter(wanted.levels)
    return recordings, readings


def _check_figure(plot: Path | None, wanted: _MeasurementPlan) -> None:
    """Refuse, before the measurements, a figure that cannot be written or would be empty."""
    if plot is not None and plot.suffix == ".toml":
        raise InputError(f"-o {plot}: -o writes a figure; --save {plot} writes the calibration")
    if plot is not None and wanted.by_hand and wanted.turns_file is None:
        raise InputError(
            f"-o {plot}: the figure shows turns, but --by-hand records none; leave out -o or "
            "--by-hand"
        )
    check_plot(plot, [file for file in (wanted.rest_file, wanted.turns_file) if file])


def _default(rig: str) -> Path:
    return Path(platformdirs.user_config_dir("armrig")) / f"calibration-{rig}.toml"


def _writable_path(path: Path) -> Path:
    """Refuse, before the measurements, a file that cannot or must not be written."""
    from armrig_core.rig.calibration_file import LostSamplesError, read_calibration

    if path.suffix != ".toml":
        raise InputError(
            f"--save {path}: a calibration is a TOML file; give a name that ends in .toml"
        )
    other = ""
    try:
        if path.exists() and read_calibration(path).made is None:
            other = "was not made by `armrig calibrate`"
    except LostSamplesError:
        pass  # a calibration without its samples may be replaced, too
    except FileError:
        other = "is not a calibration"
    if other:
        raise InputError(f"--save {path}: exists and {other}; give another name")
    return path


def _check_terminal(wanted: _MeasurementPlan, *, yes: bool) -> None:
    """Refuse to begin if there are questions but no terminal."""
    asks = wanted.by_hand or wanted.rest_file is None or wanted.turns_file is None
    if asks and not yes and not sys.stdin.isatty():
        raise InputError(
            "there is no terminal for questions: give --yes when the rig is ready, see --help"
        )


def _device_volts(code: int, recording: armrig.Recording) -> float:
    """Return the voltage, in V, that the device applies for a code, rounded to the PWM's steps."""
    from armrig_core.rig.volts import device_code, volts_of

    bits = recording.manifest.device.get("pwm_bits")
    return volts_of(device_code(code, bits) if isinstance(bits, int) and bits > 0 else code)


def _write(
    path: Path,
    estimate: CalibrationEstimate,
    base: Calibration,
    recordings: Mapping[str, armrig.Recording],
) -> None:
    """Write the calibration and its samples; each file is written completely or not at all."""
    from armrig_core.rig.calibration import Made
    from armrig_core.rig.calibration_file import toml_of

    from armrig.physics.calibration_readings import compress_readings

    first = recordings["rest"].manifest
    uids = {str(r.manifest.device.get("uid", "")) for r in recordings.values()}
    if len(uids) > 1 or len({r.manifest.rig for r in recordings.values()}) > 1:
        raise InputError(
            f"the recordings come from several devices or rigs: {', '.join(sorted(uids))}"
        )
    raw = compress_readings(recordings)
    made = Made(
        date=first.started,
        rig=first.rig,
        device_uid=uids.pop(),
        armrig=version("armrig"),
        recordings={name: r.sha256 for name, r in recordings.items()},
        raw_sha256=hashlib.sha256(raw).hexdigest(),
    )
    text = toml_of(estimate.calibration(base, made))
    path.parent.mkdir(parents=True, exist_ok=True)
    for target, data in ((raw_path(path), raw), (path, text.encode())):
        new_file = target.with_name(f".{target.name}.new")
        new_file.write_bytes(data)
        new_file.replace(target)
