"""A rig with one command: `armrig lab` starts it, and no process remains after any end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.cli import rig as of_lab
from armrig.cli.rig import _between_words, _lines, _page, _sentence, _show
from armrig.dashboard import serving
from armrig.rig.client import Rig
from armrig.rig.local_daemon import running
from armrig.rig.session import NoReplyError
from armrig_core.commands.commands import LastRun, StatusReport

from tests.clients.fake_daemon import status_report
from tests.integration.processes import children, freeze, settled, wait_for
from tests.integration.watching import Client
from tests.sampling import sampled

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
_PATIENCE_S = 60.0
# As from a terminal, also where the tests run in the background, which ignores Ctrl-C.
_LAB = """
import signal, sys
from armrig.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(main(["lab"]))
"""


@pytest.fixture(autouse=True)
def folders(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep sockets, logs and recordings apart from the user's."""
    directory = tmp_path_factory.mktemp("s")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.setenv(name, str(directory))


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Give a lab whose rig is ready."""
    said = tmp_path / "said"
    with said.open("w") as out:
        process = subprocess.Popen([sys.executable, "-c", _LAB], stdout=out, stderr=out, text=True)
        try:
            until_s = time.monotonic() + _PATIENCE_S
            while "rig ready, 0 V" not in said.read_text():
                assert process.poll() is None, said.read_text()
                assert time.monotonic() < until_s, said.read_text()
                time.sleep(0.1)
            yield process
        finally:
            process.terminate()
            process.wait(_PATIENCE_S)


def of_this_test() -> list[str]:
    """Return the programs of armrigd that run with our sockets."""
    mark = f"XDG_RUNTIME_DIR={os.environ['XDG_RUNTIME_DIR']}".encode()
    found = []
    for directory in Path("/proc").glob("[0-9]*"):
        try:
            program = (directory / "cmdline").read_bytes()
            if b"armrig_daemon" in program and mark in (directory / "environ").read_bytes():
                found.append(program.replace(b"\0", b" ").decode())
        except OSError:
            continue
    return found


@pytest.mark.real_time
@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
def test_a_lab_ends_all_its_processes(number: signal.Signals, lab: subprocess.Popen[str]) -> None:
    with Rig() as rig:  # as any command in a second terminal, by default
        rig.arm("a student")
        with rig.arrivals("sample") as samples:
            until = time.monotonic() + _PATIENCE_S
            while not any(s.u_applied_v > 0 for s in samples()):
                assert time.monotonic() < until
                rig.set(1.0)
        assert len(of_this_test()) >= 3  # service, loop, emulator
        lab.send_signal(number)
        assert lab.wait(_PATIENCE_S) == 128 + number

    assert of_this_test() == []
    with pytest.raises(NoReplyError), Rig():
        pass


@pytest.mark.real_time
def test_the_page_of_a_lab_outlives_a_frozen_and_a_killed_daemon(
    lab: subprocess.Popen[str], tmp_path: Path
) -> None:
    """The page names the command of the lab, and shows the rig when a daemon answers again."""
    said = tmp_path / "said"
    (url,) = re.findall(r"http://\S+", said.read_text())
    client = Client(url)
    (daemon,) = children(lab.pid)
    assert client.first("hello")["command"] == "armrig lab"

    freeze(daemon)
    client.wait("status", lambda seen: f"`kill -9 {daemon}` ends it" in seen["trouble"])
    wait_for(lambda: "does not answer" in said.read_text())
    os.kill(daemon, signal.SIGCONT)
    client.wait("live", lambda seen: not seen["is_stale"])
    os.kill(daemon, signal.SIGKILL)
    client.wait("status", lambda seen: "another terminal by `armrig lab`" in seen["trouble"])
    wait_for(lambda: "was ended by SIGKILL" in said.read_text())
    with running(["--emulate"], rig="1", log=tmp_path / "log"):
        client.wait("live", lambda seen: not seen["is_stale"])
        assert lab.poll() is None

    lab.send_signal(signal.SIGINT)
    assert lab.wait(_PATIENCE_S) == 128 + signal.SIGINT


_RIG = '[rig]\nname = "led"\n[outputs.y]\nunit = "V"\nper_count = 1e-4\n'


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (_RIG, "the rig 'led' cannot be emulated without [model]: give A, B and C, or the file of"),
        (_RIG + "low = 5.0\nhigh = 1.0\n", "outputs.y: low = 5.0 must be below high = 1.0"),
    ],
)
def test_a_lab_refuses_a_rig_that_it_cannot_emulate(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "led.toml").write_text(text)
    program = [sys.executable, "-m", "armrig", "lab", "--rig-file", str(tmp_path / "led.toml")]

    done = subprocess.run(program, capture_output=True, text=True, check=False)

    assert done.returncode == 1
    assert why in done.stderr
    assert "Traceback" not in done.stderr
    assert of_this_test() == []


@pytest.mark.exhaustive
def test_a_second_lab_is_refused_while_the_first_runs(lab: subprocess.Popen[str]) -> None:
    second = subprocess.run(
        [sys.executable, "-m", "armrig", "lab"], capture_output=True, text=True, check=False
    )

    assert second.returncode == 1
    assert "a daemon of rig 1 already runs" in second.stderr
    assert "Traceback" not in second.stderr
    assert lab.poll() is None
    with Rig() as rig:
        assert settled(rig) == "safe"


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("screen", ["DISPLAY", "WAYLAND_DISPLAY", ""])
def test_a_browser_is_opened_from_a_terminal_on_a_screen(
    screen: str, terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    served, opened = serving.Served(url="http://page", browser_url="http://token"), list[str]()
    given: list[serving.DashboardSettings] = []
    fakes: dict[str, Any] = {
        "armrig.dashboard.serving.dashboard": lambda x: given.append(x) or nullcontext(served),
        "webbrowser.open": opened.append,
        "sys.stdout.isatty": lambda: terminal,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(name, fake)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if screen:
        monkeypatch.setenv(screen, ":0")

    with _page("1", "armrig lab") as url:
        assert url == "http://page"

    assert opened == (["http://token"] if terminal and screen else [])
    assert given == [serving.DashboardSettings(command="armrig lab", starts_daemon=True)]


READY = ["rig ready, 0 V: /dev/a, rig 7; Ctrl-C ends the lab", "in a browser: U"]


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        (
            {},
            [*READY, "recordings go to /of/mine", "in a second terminal:", "N"],
        ),
        (
            {"arm_removed": True},
            [
                *(*READY, "recordings go to /of/mine; the arm is removed ([arm] removed)"),
                *("in a second terminal:", "N"),
            ],
        ),
        (
            {"phase": "fault", "reason": "link lost", "remedy": "plug it in", "line": "no rig"},
            ["link lost; plug it in, then `armrig reset --rig 7`"],
        ),
        ({"phase": "init", "line": "no rig"}, ["not ready: no rig; Ctrl-C ends the lab"]),
        (
            {"phase": "init", "line": "unix:/a is gone"},
            ["not ready: unix:/a is gone; lab.log says why; Ctrl-C ends the lab"],
        ),
        ({"phase": "init"}, []),
    ],
)
def test_a_lab_reports_a_ready_rig_or_the_reason(changes: dict[str, Any], lines: list[str]) -> None:
    given, log = status_report(**changes), Path("lab.log")
    assert _sentence(given, "/dev/a", "U", "N", log).splitlines() == lines
    without_page = _sentence(given, "/dev/a", "", "N", log).splitlines()
    assert without_page == [line for line in lines if "in a browser" not in line]


def test_the_view_of_a_lab_has_degrees_and_the_newest_run() -> None:
    sample = SimpleNamespace(u_applied_v=2.5, value_0=-1.0, value_1=float("nan"))
    run = {"recording": "/of/mine/1-step.mcap", "run_id": "a", "missing": 2, "samples": 30}
    run = {name: x for name, x in run.items() if name in LastRun.__struct_fields__}
    going = LastRun(**run, outcome="", finished=False)
    ended = LastRun(**run, outcome="complete", finished=True)

    assert _lines(status_report(phase="run", owner="ada"), None) == "rig 7: run, owner ada"
    head, values, last = _lines(status_report(last_run=ended), sample).splitlines()
    assert (head, last) == (
        "rig 7: safe, no owner",
        "recorded, complete: 30 samples, 1-step.mcap",
    )
    assert values == "u 2.500 V   theta_1 -57.3°   alpha –"
    assert _lines(status_report(last_run=going), None).splitlines()[1:] == [
        "recording: 30 samples, 1-step.mcap"
    ]


@pytest.mark.parametrize("as_json", [True, False])
def test_a_lab_prints_each_change_once(
    as_json: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = iter([{"phase": "init"}] * 3 + [{"line": "no rig", "phase": "init"}] * 2)
    later = iter([{}, {}])

    def status() -> StatusReport:
        try:
            return status_report(**(next(now, None) or next(later)))
        except StopIteration:
            raise KeyboardInterrupt from None

    arrivals = nullcontext(lambda: [])
    rig: Any = SimpleNamespace(status=status, arrivals=lambda _: arrivals)
    fakes: dict[str, Any] = dict.fromkeys(("_LAB_STATUS_INTERVAL_S", "_VIEW_INTERVAL_S"), 0.0)
    for name, fake in fakes.items():
        monkeypatch.setattr(of_lab, name, fake)
    monkeypatch.setattr("armrig.cli.next_step.next_line", lambda name, of: f"{name} {of.rig}")
    monkeypatch.setattr("armrig.rig.local_daemon.require_running", lambda *_: None)

    with pytest.raises(KeyboardInterrupt):
        _show(rig, SimpleNamespace(), Path("log"), "/dev/a", "", json=as_json)  # type: ignore[arg-type]

    said = capsys.readouterr().out.splitlines()
    if as_json:
        reports = [json.loads(line) for line in said]
        assert [(r["phase"], r["line"]) for r in reports] == [
            *(("init", ""), ("init", "no rig"), ("safe", "")),
        ]
    else:
        assert [said[0], said[-1]] == [
            "not ready: no rig; Ctrl-C ends the lab",
            "collect step 7",
        ]
        assert len(said) == 5


def test_lines_to_copy_are_not_wrapped() -> None:
    words = "word " * 12
    text = f"next: {words}\nin a browser: {words}\n{words}"

    lines = _between_words(text.replace("\nin", " \nin"), 30).splitlines()

    assert [line.split(" word")[0] for line in lines[:2]] == ["next:", "in a browser:"]
    assert max(map(len, lines[2:])) <= 30
    assert lines[2:] == [" ".join(["word"] * 6), "  " + " ".join(["word"] * 5), "  word"]
