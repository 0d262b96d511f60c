"""Every option of a command that serves, measures or acts reaches what does its work.

None is given its default; the work itself is another room's, and is left out here.
"""

from __future__ import annotations

import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Dataset
from armrig.cli import main
from armrig.cli.rig import _sample_line
from armrig.dashboard.foxglove import LAYOUTS
from armrig.report.batch.tasks import Identify, Report, Validate, Verify
from armrig.report.study import Orders
from armrig.rig.live_gaps import LiveGap
from armrig_core.arm import ArmParameters

from tests.clients.made_recordings import of_the_arm, sample, written
from tests.clients.told import told

FAR = "tcp/far:7447"


class _NoWorkError(RuntimeError):
    """In place of the work."""


def _taken(calls: list[Any]) -> Any:
    def work(*arguments: Any, **named: Any) -> Any:
        calls.append((*arguments, *([named] if named else [])))
        raise _NoWorkError("no work")

    return work


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Give the arguments with which the work would begin."""
    calls: list[Any] = []
    work = _taken(calls)
    for name in (
        "armrig.cli.demo.demo",
        "armrig.rig.local_daemon.running",
        "armrig.lab.router.open_router",
        "armrig.cli.record.record_many",
        "armrig.cli.record._record_one",
    ):
        monkeypatch.setattr(name, work)
    monkeypatch.setattr(os, "execv", work)
    return calls


def test_a_dashboard_is_of_its_rig_at_its_port(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[Any] = []
    served = SimpleNamespace(url="U", browser_url="B", shared_url="S", fingerprint="F")
    monkeypatch.setattr(
        "armrig.dashboard.serving.dashboard", lambda s: made.append(s) or nullcontext(served)
    )
    monkeypatch.setattr(
        "armrig.dashboard.foxglove.foxglove", lambda **of: made.append(of) or nullcontext("W")
    )
    monkeypatch.setattr("armrig.dashboard.share.own_address", lambda: "10.1.2.3")
    monkeypatch.setattr("webbrowser.open", made.append)
    ended = SimpleNamespace(wait=lambda: None)
    monkeypatch.setattr("armrig.cli.dashboard.until_signal", lambda: nullcontext(ended))
    of = ["--rig", "7", "--connect", FAR, "--port", "8899", "--share", "--foxglove", "--open"]

    assert main(["dashboard", *of, "--json"]) == 0

    settings, streams, opened = made
    assert (settings.rig, settings.connect, settings.port) == ("7", FAR, 8899)
    assert (settings.share, streams, opened) == ("10.1.2.3", {"rig": "7", "connect": FAR}, "B")
    found = json.loads(capsys.readouterr().out)
    assert found.pop("layouts") == str(LAYOUTS)
    assert found == {"url": "U", "shared_url": "S", "foxglove": "W"}


@pytest.mark.parametrize(
    ("options", "lines", "facts"),
    [
        ([], ["rig 7: U"], {"shared_url": None, "foxglove": None, "layouts": None}),
        (
            ["--share"],
            ["rig 7: U", "to watch and stop: S", "qr of S", "F"],
            {"shared_url": "S", "foxglove": None, "layouts": None},
        ),
        (
            ["--foxglove"],
            [
                "rig 7: U",
                "for Foxglove, to watch: W",
                f"layouts for Foxglove and PlotJuggler: {LAYOUTS}",
            ],
            {"shared_url": None, "foxglove": "W", "layouts": str(LAYOUTS)},
        ),
    ],
)
def test_a_dashboard_says_the_addresses_that_it_has(
    options: list[str],
    lines: list[str],
    facts: dict[str, str | None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def serving(settings: Any) -> Any:
        shared = "S" if settings.share else ""
        return nullcontext(
            SimpleNamespace(url="U", browser_url="B", shared_url=shared, fingerprint="F")
        )

    opened: list[str] = []
    monkeypatch.setattr("armrig.dashboard.serving.dashboard", serving)
    monkeypatch.setattr("armrig.dashboard.foxglove.foxglove", lambda **_: nullcontext("W"))
    monkeypatch.setattr("armrig.dashboard.share.own_address", lambda: "10.1.2.3")
    monkeypatch.setattr("armrig.dashboard.share.qr_code", lambda url: f"qr of {url}")
    monkeypatch.setattr("webbrowser.open", opened.append)
    ended = SimpleNamespace(wait=lambda: None)
    monkeypatch.setattr("armrig.cli.dashboard.until_signal", lambda: nullcontext(ended))

    assert main(["dashboard", "--rig", "7", *options]) == 0
    said = capsys.readouterr().out.splitlines()
    assert main(["dashboard", "--rig", "7", *options, "--json"]) == 0

    assert [line for line in said if line in lines] == lines
    assert len(said) == 2 + {"--share": 4, "--foxglove": 2}.get("".join(options), 0)
    assert json.loads(capsys.readouterr().out) == {"url": "U", **facts}
    assert opened == []


@pytest.mark.parametrize(
    ("name", "options", "kind"),
    [
        ("a.csv", [], "csv"),
        ("a.CSV", ["--raw"], "csv"),
        ("a.txt", ["--csv"], "csv"),
        ("a.mat", ["--signal", "alpha"], "mat"),
        ("a.csv", ["--mat", "--raw", "--signal", "alpha"], "mat"),
        ("a.parquet", ["--raw"], "parquet"),
        ("a.mcap", ["--transforms"], "transforms"),
    ],
)
def test_an_export_has_the_format_the_signal_and_the_readings_that_were_asked_for(
    name: str,
    options: list[str],
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    calls: list[Any] = []
    for each in ("csv", "mat", "parquet", "transforms"):
        monkeypatch.setattr(
            f"armrig.recordings.export.write_{each}",
            lambda recording, out, each=each, **how: calls.append((each, recording.N, out, how)),
        )
    path = written(tmp_path, of_the_arm(np.full(100, 1.0), missing=slice(50, 53)))
    given = ["export", str(path), str(tmp_path / name), *options, "--from", "0.25"]

    assert main(given) == 0
    said = capsys.readouterr().out
    assert main([*given, "--json"]) == 0

    how: dict[str, Any] = {} if kind == "transforms" else {"raw": "--raw" in options}
    if kind == "mat":
        how["output"] = options[-1]
    assert calls == [(kind, 75, tmp_path / name, how)] * 2
    assert said == f"{tmp_path / name}: 75 samples, 3 of them missing\n"
    facts = {"file": str(tmp_path / name), "samples": 75, "recording": armrig.load(path).sha256}
    assert json.loads(capsys.readouterr().out) == facts


@pytest.mark.parametrize(
    ("way", "virtual"), [("--firmware", True), ("--virtual", True), ("", False)]
)
def test_a_demo_is_as_long_and_as_random_as_it_was_asked_to_be(
    way: str, virtual: bool, given: list[Any], tmp_path: Path
) -> None:
    wanted = ["--directory", str(tmp_path / "a"), "--seconds", "7", "--seed", "5", "--json"]

    assert main(["demo", *wanted, *([way] if way else [])]) == 1

    directory, named = given[0]
    assert directory == tmp_path / "a"
    assert (named["seconds"], named["seed"]) == (7.0, 5)
    assert (named["virtual"], named["firmware"]) == (virtual, way == "--firmware")
    assert named["console"].stderr


@pytest.mark.parametrize("seconds", ["inf", "600.5"])
def test_a_demo_is_of_ten_minutes_at_most(
    seconds: str, given: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--seconds", seconds]) == 2

    assert f"--seconds {float(seconds):g}: 5 to 600 s" in told(capsys)
    assert given == []


def test_a_lab_starts_the_daemon_of_its_rig(given: list[Any], tmp_path: Path) -> None:
    config = ["--config", str(tmp_path / "a.toml")]

    assert main(["lab", "--rig", "7", *config, "--json"]) == 1
    assert main(["lab", "--rig", "7", "--port", "/dev/ttyACM3", "--json"]) == 1

    (emulated, one), (real, other) = given
    assert emulated == ["--rig", "7", "--emulate", *config]
    assert real == ["--rig", "7", "--port", "/dev/ttyACM3"]
    assert one["rig"] == other["rig"] == "7"
    assert one["log"].name == "lab-7.log"


def test_a_router_a_recorder_and_a_conformance_take_what_they_are_given(given: list[Any]) -> None:
    assert main(["router", "--listen", FAR, "--certificate", "c.pem", "--names", "n.toml"]) == 1
    many = ["--rig", "7", "--rig", "8", "-o", "folder", "--seconds", "3", "--json"]
    assert main(["record", "--from", FAR, *many]) == 1
    assert main(["record", "--from", FAR, "--rig", "7", "-o", "a.mcap", "--seconds", "3"]) == 1
    assert main(["conformance", "--device", "/dev/a", "--baud", "9600", "--json"]) == 1

    routed, many_of, one_of, replaced = given
    assert routed == (FAR, Path("c.pem"), Path("n.toml"))
    assert many_of[:4] == (FAR, ["7", "8"], Path("folder"), 3.0)
    assert one_of[:4] == (FAR, "7", Path("a.mcap"), 3.0)
    assert (many_of[-1], one_of[-1]) == ({"json": True}, {"json": False})
    assert replaced[1][1:] == [
        *("-m", "armrig_daemon", "conformance", "--device", "/dev/a", "--baud", "9600", "--json")
    ]
    assert replaced[0] == replaced[1][0] == sys.executable


def test_a_line_of_watch_has_its_units() -> None:
    from armrig.cli.rig import _WATCH_HEADING

    one = sample(42)._replace(
        u_applied_v=1.25,
        u_cmd_v=3.0,
        theta_1_rad=-1.0,
        alpha_rad=0.5,
        t_host_ns=0,
        t_sched_ns=-7_500,
    )

    gap = LiveGap(
        k_first=43,
        count=2,
        t_from_ns=1,
        t_to_ns=3,
        u_held_v=0.0,
        reason="link silent",
        published=True,
        code="unknown",
    )

    line = _sample_line(one)

    assert line.split() == ["42", "1.250", "-57.30", "28.65", "7.5"]
    assert len(line) == len(_WATCH_HEADING)
    assert _sample_line(gap).split() == [*("43", "2", "missing:", "link", "silent")]


def test_a_batch_does_its_task_for_the_recordings_that_were_chosen(
    given: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armrig.report.batch.batch.batch", _taken(given))
    monkeypatch.chdir(tmp_path)
    armrig.arx(_data(), na=1, nb=2).save("m.json")
    shared = ["weeks", "-o", "t.parquet", "--rig", "7", "--rig", "8", "--kind", "bla", "--force"]
    orders = ["--na", "2", "--nb", "3", "--nf", "5", "--nk", "6"]
    bj = ["--structure", "bj", "--nb", "3", "--nc", "2", "--nd", "5", "--nf", "4", "--nk", "6"]
    bj += ["--offset", "--stable", "--signal", "velocity", "--detrend"]

    assert main(["batch", "identify", *shared, *bj, "--workers", "3"]) == 1
    assert main(["batch", "identify", *shared, "--integrator", "--scheduler", "tcp://a:1"]) == 1
    assert main(["batch", "validate", *shared, "--model", "m.json", "--detrend"]) == 1
    assert main(["batch", "verify", *shared]) == 1
    assert main(["batch", "report", *shared, *orders, "--reports", "pdfs"]) == 1

    tasks = [task for _, task, _, _ in given]
    wanted = {"nb": 3, "nc": 2, "nd": 5, "nf": 4}
    assert tasks[0] == Identify(
        structure="bj",
        orders=wanted,
        nk=6,
        offset=True,
        stable=True,
        signal="velocity",
        detrend=True,
    )
    assert tasks[1] == Identify(structure="oe", orders={"nb": 4, "nf": 4}, integrator=True)
    assert isinstance(tasks[2], Validate)
    assert tasks[2].detrend
    assert '"structure": "arx"' in tasks[2].model
    assert tasks[3] == Verify()
    assert tasks[4] == Report(folder=str(tmp_path / "pdfs"), na=2, nb=3, nf=5, nk=6)
    for folder, _, table, named in given:
        assert (folder, table) == (tmp_path / "weeks", Path("t.parquet"))
        assert (named["rigs"], named["kinds"], named["anew"]) == (("7", "8"), ("bla",), True)
    opened = [
        (n["at_once"], n["open_executor"].func.__name__, n["open_executor"].args) for *_, n in given
    ]
    assert opened[:2] == [(6, "processes", (3,)), (256, "cluster", ("tcp://a:1",))]


def _data() -> Dataset:
    u = np.random.default_rng(1).standard_normal(200)
    return Dataset(u=u, y=np.cumsum(0.1 * u), Ts=0.02, output="theta_1", unit="rad")


@pytest.mark.parametrize("handout", [True, False])
def test_the_chassis_may_accompany_the_whole_rig_in_a_handout_alone(
    handout: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    calls: list[Any] = []
    work = _taken(calls)
    monkeypatch.setattr("armrig.report.handout_study.handout_study", work)
    monkeypatch.setattr("armrig.report.study.study", work)
    monkeypatch.chdir(tmp_path)
    u = armrig.telegraph(310, 0.1, seed=1)
    for kind in ("blackbox", "greybox"):
        written(tmp_path, of_the_arm(u, experiment=kind), f"{kind}.mcap")

    orders = ["--na", "2", "--nb", "3", "--nf", "5", "--nk", "6"]
    of_the_handout = ["--handout", "--set", "J_2=0.006", "--omega", "3", "--amplitude", "1"]
    of_a_study = ["--signal", "theta_1,alpha"]
    options = [*orders, *(of_the_handout if handout else of_a_study)]
    assert main(["report", *options, "blackbox.mcap", "greybox.mcap"]) == 1

    cases = {"handout": ArmParameters(), "J_2=0.006": ArmParameters(J_2=0.006)}
    more: dict[str, Any] = {"outputs": ["theta_1", "alpha"]}
    if handout:
        more = {"cases": cases, "amplitude": 1.0, "omega": 3.0}
    assert calls[0][-1] == {"orders": Orders(na=2, nb=3, nf=5, nk=6), **more}
    assert ("are two plants" in told(capsys)) is not handout


def test_a_board_is_asked_what_it_runs_at_the_speed_that_was_given(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []
    flash = "armrig.lab.flash"
    monkeypatch.setattr(f"{flash}.avrdude.find", lambda: "avrdude")
    monkeypatch.setattr(f"{flash}.avrdude.loader", lambda program, port: "4.4")
    monkeypatch.setattr(f"{flash}.avrdude.write", lambda *call: asked.append(call[0]))
    monkeypatch.setattr(f"{flash}.avrdude.plugged_in", lambda: [])
    board = SimpleNamespace(port="/dev/ttyACM3", name="Uno")
    monkeypatch.setattr(f"{flash}.avrdude.chosen", lambda port, _: asked.append(port) or board)
    monkeypatch.setattr(f"{flash}.avrdude.held", lambda _: nullcontext())
    monkeypatch.setattr(f"{flash}.avrdude.greeting", lambda *of: asked.append(of))

    assert main(["flash", "--port", "/dev/ttyACM3", "--baud", "115200", "--yes"]) == 1

    port, call, greeted = asked
    assert (port, greeted) == ("/dev/ttyACM3", ("/dev/ttyACM3", 115_200))
    assert "/dev/ttyACM3" in " ".join(call)
    assert "does not answer at 115200 baud" in capsys.readouterr().err.replace("\n", " ")
