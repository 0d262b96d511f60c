"""Options of `armrigd`, in this process: what each command does with them."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from armrig_daemon import command_line
from armrig_daemon.__main__ import main
from armrig_daemon.command_line import app
from armrig_daemon.conformance.host import LineHost
from armrig_daemon.conformance.rule import Result
from armrig_daemon.emulator import real_time
from armrig_daemon.emulator.settings import EmulatorSettings
from msgspec.structs import replace
from typer.testing import CliRunner


def _armrigd(*arguments: str | Path, given: str = "") -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments], input=given)
    return done.exit_code, done.output


@pytest.fixture
def emulated(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Record the calls of the emulator, which is held up by 264.4 ms and returns 3."""
    called: list[Any] = []

    def emulate(port: Path, settings: EmulatorSettings, **given: Any) -> int:
        called.append((port, settings, given))
        given["held_up"](264_400_000)
        return 3

    monkeypatch.setattr(real_time, "emulate", emulate)
    return called


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Record the ports and speeds at which ESTOP is sent; a speed of 9600 has no answer."""
    calls: list[tuple[str, int]] = []
    monkeypatch.setattr(
        "armrig_daemon.loop.estop.estop",
        lambda port, baud: calls.append((port, baud)) or baud != 9600,
    )
    return calls


@pytest.mark.parametrize(
    ("options", "changes", "announced"),
    [
        ([], {"seed": 5}, "armrigd: an emulated rig is at rig, 500000 baud, 0 to 5 V; drive it "),
        (["--seed", "0"], {"seed": 0}, "with `armrigd run --port rig`, end it with Ctrl-C"),
        (["--seed", "7"], {"seed": 7}, "500000 baud"),
        (
            ["--baud", "250000"],
            {"seed": 5, "baud": 250_000},
            "at rig, 250000 baud, 0 to 5 V; drive it with "
            "`ARMRIG_DEVICE_BAUD=250000 armrigd run --port rig`",
        ),
    ],
)
def test_an_option_of_the_emulator_overrides_its_file(
    options: list[str],
    changes: dict[str, Any],
    announced: str,
    tmp_path: Path,
    emulated: list[Any],
) -> None:
    file = tmp_path / "emulator.toml"
    file.write_text("[emulator]\nseed = 5\n")

    code, _ = _armrigd("emulate", "--port", "rig", "--config", file, "--trace", "t.csv", *options)

    assert code == 3
    ((port, settings, given),) = emulated
    assert settings == replace(EmulatorSettings(), **changes)
    assert (port, given["trace"]) == (Path("rig"), Path("t.csv"))
    assert announced in given["started"]


def test_command_line_options_override_the_named_file(
    tmp_path: Path, stopped: list[tuple[str, int]]
) -> None:
    file = tmp_path / "a.toml"
    file.write_text('[device]\nport = "/dev/of-file"\nbaud = 115200\n[timing]\nTs = 0.05\n')

    plain = _armrigd("estop", "--config", file)
    other = _armrigd("estop", "--config", file, "--port", "/dev/other", "--rig", "2")
    wrong = _armrigd("estop", "--config", file, "--rig", "A")

    assert stopped == [("/dev/of-file", 115_200), ("/dev/other", 115_200)]
    assert (plain[0], other[0], wrong[0]) == (0, 0, 78)
    assert "armrigd: estop: /dev/of-file is in ESTOP, 0 V; `armrig reset` ends ESTOP" in plain[1]
    assert "estop: nothing sent: " in wrong[1]
    assert "rig id 'A'" in wrong[1]


def test_an_estop_that_is_not_confirmed_is_a_failure(
    tmp_path: Path, stopped: list[tuple[str, int]]
) -> None:
    file = tmp_path / "a.toml"
    file.write_text('[device]\nport = "/dev/of-file"\nbaud = 9600\n[timing]\nTs = 0.1\n')

    code, said = _armrigd("estop", "--config", file)

    assert code == 1
    assert "estop: sent to /dev/of-file, no answer: check that the motor stands still" in said


@pytest.mark.parametrize("result", ["success", "exit-code"])
def test_after_a_service_that_did_not_fail_no_estop_is_sent(
    result: str,
    tmp_path: Path,
    stopped: list[tuple[str, int]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SERVICE_RESULT", result)
    monkeypatch.setenv("EXIT_STATUS", "1")
    file = tmp_path / "a.toml"
    file.write_text('[device]\nport = "/dev/a"\n')

    code, _ = _armrigd("estop", "--config", file, "--after-failure")

    assert (code, len(stopped)) == (0, result != "success")


def test_virtual_runs_of_a_seed_are_recorded_in_the_folder(tmp_path: Path) -> None:
    """The daemon's defaults for an emulated rig hold, unless the file has others."""
    file = tmp_path / "a.toml"
    file.write_text("[limits]\nu_max_v = 3\n")
    lines = [{"u": [1.0, 2.0], "experiment": "odd"}, {"u": [4.0]}]
    told = "".join(f"{json.dumps(line)}\n" for line in lines)

    code, said = _armrigd(
        "virtual", "--directory", tmp_path / "r", "--config", file, "--seed", "61", given=told
    )

    path, refused = said.splitlines()
    assert code == 1
    assert Path(path).parent == tmp_path / "r"
    assert Path(path).name.startswith("1-odd-20000101T0001")
    assert refused == "armrigd: u[0]=4 V is outside 0 … 3 V"


@pytest.mark.parametrize("options", [[], ["--device", "/dev/a", "--firmware"]])
def test_the_conformance_of_one_device_is_tested(options: list[str]) -> None:
    code, said = _armrigd("conformance", "--motor-unplugged", *options)

    assert code == 2
    assert "give either --device DEVICE, or --firmware" in said


def test_conformance_needs_confirmation_that_the_motor_is_unplugged() -> None:
    code, said = _armrigd("conformance", "--device", "/dev/a")

    assert code == 1
    assert "no terminal for the question; confirm with --motor-unplugged" in said


@pytest.mark.parametrize(
    ("outcomes", "exit_code", "summary"),
    [
        (["pass", "not tried"], 0, "all 1 tested rules hold; 1 not tried"),
        (["pass", "FAIL", "FAIL"], 1, "2 of 3 rules are broken; 0 not tried"),
    ],
)
@pytest.mark.parametrize("is_json", [False, True])
def test_the_results_of_a_device_are_printed_and_decide_the_exit_code(
    outcomes: list[str],
    exit_code: int,
    summary: str,
    is_json: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    results = [Result(n, f"rule {n}", outcome, "") for n, outcome in enumerate(outcomes)]

    def tried(host: LineHost, report: Callable[[Result], None], rules: Any) -> list[Result]:
        for result in results:
            report(result)
        return results

    line = SimpleNamespace(now_ns=lambda: 0)
    monkeypatch.setattr(command_line, "_line_and_rules", lambda *_: (line, ()))
    monkeypatch.setattr("armrig_daemon.conformance.suite.run", tried)
    options = ["--json"] if is_json else []

    code, said = _armrigd("conformance", "--device", "/dev/a", "--motor-unplugged", *options)

    assert code == exit_code
    if is_json:
        found = json.loads(said)
        assert [rule["outcome"] for rule in found["rules"]] == outcomes
        assert found["broken"] == outcomes.count("FAIL")
        return
    assert said.splitlines() == [
        *(f"{result.outcome:9}  {result.section}  {result.sentence}" for result in results),
        summary,
    ]


@pytest.mark.parametrize("has_daemon", [True, False])
def test_a_stall_of_the_emulator_is_reported_to_its_daemon_or_its_user(
    has_daemon: bool, emulated: list[Any]
) -> None:
    out, into = os.pipe()
    options = ["--stalls-fd", str(into)] if has_daemon else []

    code, said = _armrigd("emulate", "--port", "rig", *options)

    os.close(into)
    told = "armrigd: emulator held up 264 ms by this machine"
    assert (code, os.read(out, 100)) == (3, b"264400000\n" if has_daemon else b"")
    assert (told in said) != has_daemon
    os.close(out)


def test_the_socket_overwrites_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("nowhere")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))

        for name in ("socket", "nothing"):
            command_line._check_no_file(tmp_path / name)
    for name in ("file", "link"):
        with pytest.raises(typer.Exit) as refused:
            command_line._check_no_file(tmp_path / name)
        assert refused.value.exit_code == 78
        told = f"armrigd: {tmp_path}/{name}: another file has the name of the socket; move it away"
        assert capsys.readouterr().err == f"{told}\n"


def test_linear_algebra_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.setattr("armrig_daemon.command_line.app", lambda: None)

    main()

    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
