"""`armrig calibrate`, and recordings read with its file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.cli import main
from armrig.cli.calibration import (
    _default,
    _measure,
    _MeasurementPlan,
    _writable_path,
    check_turns,
    conversion_through,
    meter_reading,
)
from armrig.rig import collection
from armrig.rig.collection import Collected, Plan
from armrig_core.commands import commands
from armrig_core.commands.codes import RefusalCode
from armrig_core.errors import InputError
from armrig_core.rig.calibration import Calibration, Made
from armrig_core.rig.calibration_file import raw_path, read_calibration, toml_of
from msgspec.structs import replace

from tests.clients.calibration_rig import recording_of
from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import written
from tests.clients.made_turns import made_turns, still

TURNED = made_turns(noise=32.0, direction=-1)


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep away from a daemon that the user may have."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("s")))


def _files(folder: Path) -> tuple[str, ...]:
    """Return the options that name a rest and turns that were recorded before."""
    options: list[str] = []
    for name, readings in (("rest", still()), ("turns", TURNED)):
        path = folder / f"{name}.mcap"
        path.write_bytes(recording_of(readings, f"calibrate-{name}"))
        options += [f"--{name}", str(path)]
    return tuple(options)


class _Daemon(FakeDaemon):
    """Reports the calibration file of its configuration."""

    named = ""

    def status(self) -> commands.StatusReport:
        return replace(super().status(), calibration_file=self.named)


@pytest.fixture
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Daemon]:
    """Give a daemon that takes any calibration."""
    with _Daemon(f"unixsock-stream/{tmp_path_factory.mktemp('d')}/1.sock") as daemon:
        yield daemon


@pytest.mark.parametrize(
    ("options", "answer", "is_used", "said"),
    [
        ((), "\n", True, "Load the calibration into the running daemon now? [Y/n]"),
        ((), "n\n", False, "not in use\n"),
        ((), None, False, "not in use: --use loads the calibration into the running daemon"),
        (
            ("--use",),
            None,
            True,
            "from the next sample on, until `armrig lab` or armrigd ends",
        ),
        (
            ("--yes",),
            None,
            True,
            "from the next sample on, until `armrig lab` or armrigd ends",
        ),
        (("--no-use", "--yes"), None, False, "not in use\n"),
    ],
)
def test_the_running_daemon_loads_a_calibration_after_consent(
    options: tuple[str, ...],
    answer: str | None,
    is_used: bool,
    said: str,
    daemon: _Daemon,
    tmp_path: Path,
    typed: Callable[[str | None], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    typed(answer)
    output = tmp_path / "c.toml"
    given = [*_files(tmp_path), "--save", str(output), "--connect", daemon.endpoint, *options]

    assert main(["calibrate", *given]) == 0

    told = capsys.readouterr().err
    assert said in told
    assert f'[calibration]\nfile = "{output}"\n' in told
    sent = [r for r in daemon.asked if isinstance(r, commands.CalibrateRequest)]
    assert [r.calibration for r in sent] == [read_calibration(output)] * is_used
    assert [r.raw for r in sent] == [raw_path(output).read_bytes()] * is_used


def test_calibrate_prints_the_copy_that_replaces_the_configured_file(
    daemon: _Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "c.toml"
    given = ["calibrate", *_files(tmp_path), "--save", str(output), "--connect", daemon.endpoint]

    daemon.named = "/etc/armrig/it is here.toml"
    assert main([*given, "--use"]) == 0
    other = capsys.readouterr().err
    daemon.named = str(output)
    assert main([*given, "--use"]) == 0

    assert "armrigd reads /etc/armrig/it is here.toml at its next start" in other
    copies = f"cp {output} '/etc/armrig/it is here.toml'"
    copies += f" && cp {tmp_path}/c.csv.gz '/etc/armrig/it is here.csv.gz'\n"
    assert copies in other
    assert "reads this file at its next start, too" in capsys.readouterr().err


def test_calibrate_keeps_its_file_if_the_daemon_refuses(
    daemon: _Daemon, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "c.toml"
    given = ["calibrate", *_files(tmp_path), "--save", str(output), "--connect", daemon.endpoint]
    daemon.refusals["calibrate"] = commands.build_refusal(
        RefusalCode.IN_FAULT,
        "in fault (link lost): correct the cause, then reset",
        reason="link lost",
    )

    assert main([*given, "--use"]) == 1

    said = capsys.readouterr().err.replace("\n", " ")
    assert f"{output} is written, but not in use: in fault (link lost): repair it, then" in said
    assert f"`armrig reset --connect {daemon.endpoint}`" in said
    assert read_calibration(output).made is not None


def test_calibrate_guides_the_user_through_each_step(
    tmp_path: Path,
    typed: Callable[[str | None], None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _files(tmp_path)
    plans: list[Plan] = []

    def collect(plan: Plan, **_: Any) -> Collected:
        plans.append(plan)
        path = tmp_path / f"{plan.experiment.removeprefix('calibrate-')}.mcap"
        return Collected(path, 0, 0.01, None, "", None)

    monkeypatch.setattr(collection, "collect", collect)
    typed("\ny\n\n0.97\n\n")
    output = tmp_path / "c.toml"

    code = main(["calibrate", "--volts", "1", "--volts", "2", "--save", str(output)])

    said = capsys.readouterr().err
    assert code == 0, said
    assert [p.experiment for p in plans] == ["calibrate-rest", "calibrate-turns"]
    assert {p.pacing for p in plans} == {"scheduled"}
    assert all(p.dead_man for p in plans)
    assert [p.seconds for p in plans] == [3.0, 24.5]
    assert plans[1].details == {"levels": [1.0, 2.0], "level_seconds": 12.0}
    u = plans[1].make(2450, 0.01)
    assert u.tolist() == [0.0] * 50 + [1.0] * 1200 + [2.0] * 1200
    assert not plans[0].make(300, 0.01).any()
    for text in (
        "let the arm hang still",
        "turn at 1 V, 2 V, 12 s each",
        "of the meter at 2 V",
    ):
        assert text in said
    assert said.index("Is a voltmeter at the motor's terminals?") < said.index("will turn at")
    assert read_calibration(output).driver.gain == pytest.approx(0.97, rel=2e-3)


@pytest.mark.parametrize("given", [(), ("--rest",), ("--rest", "--turns", "--by-hand")])
def test_calibrate_without_a_terminal_requires_yes(
    given: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = _files(tmp_path)
    paths = dict(zip(files[::2], files[1::2], strict=True))
    options = [text for name in given for text in (name, *filter(None, [paths.get(name)]))]

    assert main(["calibrate", *options, "--save", str(tmp_path / "c.toml")]) == 1

    assert "there is no terminal for questions: give --yes" in capsys.readouterr().err


def _wanted(**changes: Any) -> _MeasurementPlan:
    given: dict[str, Any] = {"volts": [2.0], "level_seconds": 1.0}
    return _MeasurementPlan(**given | changes)


def test_calibrate_requests_a_deflection_before_it_records_the_arm() -> None:
    done: list[str] = []
    ask: Any = SimpleNamespace(ready=done.append)
    play: Any = SimpleNamespace(rest=lambda experiment, s: done.append(f"{experiment} {s:g} s"))

    _measure(_wanted(by_hand=True), ask, play)

    assert [done[0][:15], done[1], done[2][:15], done[3]] == [
        *("Turn the chassi", "calibrate-rest 3 s", "Deflect the arm", "calibrate-hand 3 s"),
    ]
    assert done[2].endswith("hold it for 3 s.")


def test_calibrate_does_not_request_readings_given_as_options() -> None:
    done: list[str] = []
    ask: Any = SimpleNamespace(ready=lambda _: None)
    play: Any = SimpleNamespace(
        rest=lambda experiment, _: done.append(experiment),
        turns=lambda levels, s: done.append(f"{levels} {s:g} s"),
    )

    _, readings = _measure(_wanted(meter=["9=1.5"]), ask, play)

    assert readings == [(9, 1.5)]
    assert done == ["calibrate-rest", "[2.0] 1 s"]


@pytest.mark.parametrize(
    ("text", "reading"),
    [("65535=10", (65535, 10.0)), ("1=0.01", (1, 0.01)), ("32768=5.1", (32768, 5.1))],
)
def test_a_meter_reading_may_be_at_any_code_and_with_another_supply(
    text: str, reading: tuple[int, float]
) -> None:
    assert meter_reading(text) == reading


def test_turns_may_have_the_rig_s_largest_voltage_and_any_time_up_to_ten_minutes() -> None:
    check_turns([0.1, 5.0], 3.1)
    check_turns([5.0], 600.0)

    for levels, seconds, said in (
        ([5.0, 0.0], 9.0, "--volts 0: must be more than 0 and at most 5 V"),
        ([1.0, -2.0], 9.0, "--volts -2: must be more than 0 and at most 5 V"),
        ([1.0], 3.0, "--level-seconds 3: must be more than 3 s and at most 600 s; the first 2 s"),
        ([1.0], 601.0, "--level-seconds 601: must be more than 3 s and at most 600 s"),
    ):
        with pytest.raises(InputError, match=said):
            check_turns(levels, seconds)


@pytest.mark.parametrize("other", [{"device": {"uid": "beef"}}, {"rig": "9"}])
def test_recordings_of_different_rigs_or_devices_are_refused(
    other: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = _files(tmp_path)
    written(tmp_path, recording_of(TURNED, "calibrate-turns", **other), "turns.mcap")

    assert main(["calibrate", *files, "--save", str(tmp_path / "c.toml"), "--no-use"]) == 1

    assert "the recordings come from several devices or rigs: " in capsys.readouterr().err
    assert not (tmp_path / "c.toml").exists()


def test_the_name_of_a_calibration_file_contains_its_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", "/of/mine")

    assert _default("7") == Path("/of/mine/armrig/calibration-7.toml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (toml_of(Calibration()), "exists and was not made by `armrig calibrate`"),
        ("[device]\n", "exists and is not a calibration"),
    ],
)
def test_calibrate_replaces_only_calibration_files(text: str, said: str, tmp_path: Path) -> None:
    other, own = tmp_path / "other.toml", tmp_path / "own.toml"
    other.write_text(text)
    made = Made(**dict.fromkeys(("date", "rig", "device_uid", "armrig"), "1"), raw_sha256="ab")
    own.write_text(toml_of(Calibration(made=made)))

    with pytest.raises(InputError, match=f"--save {other}: {said}; give another name"):
        _writable_path(other)
    assert _writable_path(own) == own
    assert _writable_path(tmp_path / "new.toml") == tmp_path / "new.toml"


def test_two_points_make_a_line_and_more_points_a_table() -> None:
    line = conversion_through([(10_000, 1.5), (20_000, 3.0)])

    assert line == {"zero_counts": pytest.approx(0), "per_count": pytest.approx(1.5e-4)}
    table = [(10_000.04, 60.0), (20_000, 40.0), (40_000, 20.0)]
    assert conversion_through(table) == {"points": [[10_000, 60], [20_000, 40], [40_000, 20]]}
    for near in ([(10_000, 1.5), (10_630, 3.0)], [(10_000, 2.0), (20_000, 2.0)]):
        with pytest.raises(InputError, match="give values that are further apart"):
            conversion_through(near)
    with pytest.raises(InputError, match="the values must increase, or decrease, from each"):
        conversion_through([(10_000, 1.0), (20_000, 3.0), (30_000, 2.0)])
