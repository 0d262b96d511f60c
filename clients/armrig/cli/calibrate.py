"""The command that calibrates a rig: a rest, a few slow turns, and readings of a meter."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.options import Connect, Json, RigId, print_json, print_table, tell

if TYPE_CHECKING:
    from armrig.recordings.calibration import Estimate
    from armrig.recordings.recording import Recording

_OWNER = "armrig calibrate"
_DEAD_MAN_S = 1.0
_LONGEST_LEVEL_S = 600.0
_START_S = 0.5  # at 0 V, for the arm's reading before it is set in motion


def calibrate(
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="TOML", help="File to write; the user's by default."
        ),
    ] = None,
    volts: Annotated[
        list[float] | None,
        typer.Option("--volts", help="Voltage to turn at; several times for several. 1, 2 and 3."),
    ] = None,
    level_seconds: Annotated[
        float, typer.Option("--level-seconds", help="How long each voltage is held.")
    ] = 12.0,
    rest_seconds: Annotated[
        float,
        typer.Option("--rest-seconds", help="Length of the rest, and of a hand's deflection."),
    ] = 3.0,
    meter: Annotated[
        list[str] | None,
        typer.Option(
            "--meter",
            metavar="CODE=VOLTS",
            help="What a meter shows at the motor for a code of 1 to 65535; several times.",
        ),
    ] = None,
    meter_std: Annotated[
        float, typer.Option("--meter-std", help="Standard deviation of such a reading in V.")
    ] = 0.01,
    by_hand: Annotated[
        bool,
        typer.Option("--by-hand", help="No motor: the arm's sign from a deflection by hand."),
    ] = False,
    rest_file: Annotated[
        Path | None, typer.Option("--rest", metavar="F", help="A recording of a rest made before.")
    ] = None,
    turns_file: Annotated[
        Path | None, typer.Option("--turns", metavar="F", help="A recording of turns made before.")
    ] = None,
    Ts: Annotated[
        float | None, typer.Option("--Ts", help="Sampling time in s; the daemon's by default.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing.")] = False,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Calibrate potentiometers and motor, guided.

    Each figure comes with its standard deviation.
    """
    from armrig.recordings.calibration import estimate

    readings = [_meter(text) for text in meter or []]
    levels = volts or [1.0, 2.0, 3.0]
    path = _checked(output or _default(rig))
    _check_turns(levels, level_seconds)
    _check_questions(yes=yes, asked=by_hand or rest_file is None or turns_file is None)
    ask = _Dialogue(yes=yes)
    play = _Player(Ts=Ts, rig=rig, connect=connect)
    rest, turns, deflected = _loaded(rest_file), _loaded(turns_file), None
    if rest is None:
        ask.ready("Turn the chassis to its mark for theta_1 = 0 and let the arm hang still.")
        rest = play.rest("calibrate-rest", rest_seconds)
    if by_hand:
        ask.ready(
            "Deflect the arm the way that the chassis turns with a voltage, hold it, and go on "
            f"holding it for {rest_seconds:g} s."
        )
        deflected = play.rest("calibrate-hand", rest_seconds)
    elif turns is None:
        text = ", ".join(f"{v:g} V" for v in levels)
        ask.ready(f"The chassis will turn at {text}, {level_seconds:g} s each: keep clear of it.")
        turns = play.turns(levels, level_seconds)
    if not by_hand and turns_file is None and not readings:
        readings = ask.meter(levels)
    base = _base(rest)
    recordings = {"rest": rest, "turns": turns, "deflected": deflected}
    found = estimate(
        rest,
        turns,
        deflected=deflected,
        meter=[(_applied(code, rest), shown) for code, shown in readings],
        meter_std_v=meter_std,
        base=base,
    )
    _write(path, found, base, {name: r for name, r in recordings.items() if r is not None})
    _print(path, found, json=json)


class _Dialogue:
    """Asks the person at the terminal, or nobody."""

    def __init__(self, *, yes: bool) -> None:
        self._quiet = yes

    def ready(self, text: str) -> None:
        """Say what to do, and wait until it is done."""
        if not self._quiet:
            typer.prompt(f"{text} Then press Enter", default="", show_default=False, err=True)

    def meter(self, levels: list[float]) -> list[tuple[int, float]]:
        """Return what a meter showed at the motor's terminals."""
        from armrig_core.volts import code_of

        readings: list[tuple[int, float]] = []
        for u in [] if self._quiet else levels:
            text = f"What a meter showed at the motor for {u:g} V, in V (Enter: nothing)"
            shown = typer.prompt(text, default="", show_default=False, err=True)
            if shown:
                readings.append(_meter(f"{code_of(u)}={shown}"))
        return readings


class _Player:
    """Plays the runs of a calibration, and gives their recordings."""

    def __init__(self, *, Ts: float | None, rig: str, connect: str | None) -> None:
        self._Ts, self._rig, self._connect = Ts, rig, connect

    def rest(self, experiment: str, seconds: float) -> Recording:
        """Record the rig at 0 V."""
        import numpy as np

        return self._played(experiment, seconds, {}, lambda N, _: np.zeros(N))

    def turns(self, levels: list[float], level_seconds: float) -> Recording:
        """Record the rig turning at one voltage after the other."""
        import numpy as np

        seconds = _START_S + level_seconds * len(levels)

        def make(N: int, Ts: float) -> Any:
            t = np.arange(N) * Ts - _START_S
            at = np.minimum((t / level_seconds).astype(int), len(levels) - 1)
            return np.where(t < 0, 0.0, np.array(levels)[at])

        details = {"levels": levels, "level_seconds": level_seconds}
        return self._played("calibrate-turns", seconds, details, make)

    def _played(
        self, experiment: str, seconds: float, details: dict[str, Any], make: Any
    ) -> Recording:
        from armrig.recordings.loading import load
        from armrig.rig.collection import Plan, collect

        plan = Plan(
            experiment=experiment,
            make=make,
            details=details,
            seconds=seconds,
            Ts=self._Ts,
            pacing="scheduled",
            owner=_OWNER,
            dead_man=_DEAD_MAN_S,
        )
        return load(collect(plan, rig=self._rig, connect=self._connect, tell=tell).path)


def _default(rig: str) -> Path:
    import platformdirs

    return Path(platformdirs.user_config_dir("armrig")) / f"calibration-{rig}.toml"


def _checked(path: Path) -> Path:
    """Refuse, before any work, a file that cannot or must not be written."""
    from armrig_core.calibration_file import CalibrationFileError, read_calibration

    if path.suffix != ".toml":
        msg = f"-o {path}: a calibration is a TOML; give a name that ends in .toml"
        raise ValueError(msg)
    if path.exists():
        try:
            made = read_calibration(path).made
        except CalibrationFileError as err:
            if "csv.gz" not in str(err):  # a calibration that has lost its samples may go
                msg = f"-o {path}: is there already, and no calibration; give another name"
                raise ValueError(msg) from err
        else:
            if made is None:
                msg = f"-o {path}: is there already, and was not made by `armrig calibrate`"
                raise ValueError(msg)
    return path


def _check_turns(levels: list[float], level_seconds: float) -> None:
    """Refuse voltages that the rig does not stand, and times too short for a speed to settle."""
    from armrig_core.volts import U_MAX_V

    from armrig.recordings.calibration.rotation import LEAST_S, SETTLE_S

    for u in levels:
        if not 0 < u <= U_MAX_V:
            msg = f"--volts {u:g}: must be more than 0 and at most {U_MAX_V:g} V"
            raise ValueError(msg)
    if not SETTLE_S + LEAST_S < level_seconds <= _LONGEST_LEVEL_S:
        msg = f"--level-seconds {level_seconds:g}: must be more than {SETTLE_S + LEAST_S:g} s, "
        msg += f"of which the first {SETTLE_S:g} s are not used, and at most {_LONGEST_LEVEL_S:g}"
        raise ValueError(msg)


def _check_questions(*, yes: bool, asked: bool) -> None:
    if asked and not yes and not sys.stdin.isatty():
        msg = "there is no terminal to ask at: give --yes when the rig is ready, see --help"
        raise ValueError(msg)


def _meter(text: str) -> tuple[int, float]:
    """Return the code and the reading of CODE=VOLTS."""
    from armrig_protocol.messages import CODE_FULL_SCALE

    code, _, volts = text.partition("=")
    try:
        reading = int(code), float(volts)
    except ValueError:
        reading = 0, 0.0
    if not 0 < reading[0] <= CODE_FULL_SCALE or not 0 < reading[1] <= 10:
        msg = f"--meter {text}: must be CODE=VOLTS, a code of 1 to {CODE_FULL_SCALE} and what the "
        msg += "meter shows, such as 32768=2.49"
        raise ValueError(msg)
    return reading


def _applied(code: int, rest: Recording) -> float:
    """Return the voltage that the device makes of a code; a duty has few steps."""
    from armrig_core.volts import applied_code, volts_of

    bits = rest.manifest.device.get("pwm_bits")
    return volts_of(applied_code(code, bits) if isinstance(bits, int) and bits > 0 else code)


def _loaded(path: Path | None) -> Recording | None:
    from armrig.recordings.loading import load

    return None if path is None else load(path)


def _base(rest: Recording) -> Any:
    """Return what was in force at the rest, for what is not measured."""
    from armrig_core.calibration import Calibration
    from msgspec.structs import replace

    return replace(rest.calibration or Calibration(), made=None)


def _write(path: Path, found: Estimate, base: Any, recordings: dict[str, Recording]) -> None:
    """Write the calibration and its samples, each as a whole."""
    import hashlib
    from importlib.metadata import version

    from armrig_core.calibration import Made
    from armrig_core.calibration_file import raw_path, toml_of

    from armrig.recordings.calibration import compressed

    first = recordings["rest"].manifest
    uids = {str(r.manifest.device.get("uid", "")) for r in recordings.values()}
    if len(uids) > 1 or len({r.manifest.rig for r in recordings.values()}) > 1:
        msg = f"the recordings are of several devices or rigs: {', '.join(sorted(uids))}"
        raise ValueError(msg)
    raw = compressed(recordings)
    made = Made(
        date=first.started,
        rig=first.rig,
        device_uid=uids.pop(),
        armrig=version("armrig"),
        recordings={name: r.sha256 for name, r in recordings.items()},
        raw_sha256=hashlib.sha256(raw).hexdigest(),
    )
    text = toml_of(found.calibration(base, made))
    path.parent.mkdir(parents=True, exist_ok=True)
    for target, data in ((raw_path(path), raw), (path, text.encode())):
        whole = target.with_name(f".{target.name}.new")
        whole.write_bytes(data)
        whole.replace(target)


def _print(path: Path, found: Estimate, *, json: bool) -> None:
    for warning in found.warnings:
        tell(warning)
    figures = found.figures()
    if json:
        facts = {"calibration": str(path), "figures": figures, "alpha_sign": found.alpha_sign}
        print_json(facts | {"warnings": found.warnings})
        return
    rows = [(name, f"{_in_words(f.value, f.std)}") for name, f in figures.items()]
    sign = {1: "grows with the counts", -1: "falls with the counts", 0: "not seen"}
    print_table(*rows, ("alpha", sign[found.alpha_sign]), ("calibration", str(path)))
    tell(
        f'to use it: [calibration] file = "{path.absolute()}" in armrigd\'s configuration, and '
        "start armrigd anew"
    )


def _in_words(value: float, std: float) -> str:
    from armrig.numerics.quantities import places

    if not std:
        return f"{value:g}"
    if abs(value) < 1e-2 and std < 1e-4:
        return f"{value:.6e} ± {std:.1e}"
    decimals = places(std)
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"
