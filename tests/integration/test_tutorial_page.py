"""docs/tutorial.md and docs/close-the-loop.md: their lines run in their order.

They print what the pages show. Lines that collect run once on an emulated rig in real time, with
the shorter runs of the pages' own markers. Lines that read data use the recordings of the page's
figures, those of the closed loop what was collected. Only the installation does not run here.
"""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.recorded_data import recording_path
from armrig.recordings.usability import all_doubts
from armrig.report.document import MOST_PAGES
from armrig_core.commands.commands import ControlRequest
from armrig_daemon.config import Config
from armrig_daemon.service.virtual_service import LEASE, VirtualService

from tests.clients import pages

PAGE = pages.DOCS / "tutorial.md"
TEXT = PAGE.read_text(encoding="utf-8")
BLOCKS: list[tuple[str, str]] = re.findall(r"```(sh|toml|python|text)\n(.*?)```", TEXT, re.DOTALL)
SHORTER = dict(re.findall(r'<!-- the test has "(.+?)" as "(.+?)" -->', TEXT))
LIVE = ("lab", "status", "calibrate", "collect")
INSTALLED = ("python3 ", ". ", "pip ")
CONTROL = "armrig collect control law.json --reference step --low 2 --high 4 --name loop"
STEP: dict[str, Any] = {"experiment": "control-loop", "reference": [2.0] * 150 + [4.0] * 150}


def _shorter(text: str) -> str:
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    return text


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the folder of the page's recordings, in virtual time; we are in another one."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(pages.DOCS / "figures"))
    pages.record_all("tutorial.py", folder)
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(folder))
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.mark.exhaustive
def test_every_line_that_needs_no_rig_prints_what_the_page_shows(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the page's order; the numbers within 5 %."""
    names: dict[str, Any] = {"path": recorded / "1-blackbox-tuesday.mcap"}
    printed: list[str] = []
    commands = compared = 0

    for language, text in BLOCKS:
        if language == "python":
            lines = text if "Rig(" not in text else "import armrig"
            exec(compile(lines, str(PAGE), "exec"), names)
        for line in text.splitlines() if language == "sh" else ():
            if line.startswith("armrig ") and line.split()[1] not in LIVE:
                assert main(shlex.split(_shorter(line))[1:]) == 0, line
                commands += 1
            if line.startswith(CONTROL):
                loop = ControlRequest(
                    lease=LEASE, n=0, law=armrig.control.load_law("law.json"), **STEP
                )
                VirtualService(Config(), recorded, seed=1).record(loop)
        said = capsys.readouterr()
        printed += [*said.out.splitlines(), *said.err.splitlines()]
        if language == "text" and not text.startswith("motor_rad"):
            for line in text.splitlines():
                _assert_printed(line, printed)
                compared += 1

    assert (commands, compared) == (23, 30)
    count = re.search(rb"/Type/Pages/Count (\d+)", (recorded.parent / "report.pdf").read_bytes())
    assert count is not None
    assert 3 < int(count[1]) <= MOST_PAGES


def _assert_printed(line: str, printed: list[str]) -> None:
    """Assert that a line was printed: the same words, and numbers that are nearly the same."""
    alike = [p for p in printed if pages.without_numbers(p) == pages.without_numbers(line)]
    assert alike, line
    wanted = pages.numbers(line)
    assert any(np.allclose(pages.numbers(p), wanted, rtol=0.05, atol=0.0) for p in alike), alike


class Lab:
    """`armrig lab` in a terminal of its own: one at a time."""

    def __init__(self) -> None:
        self._running: subprocess.Popen[str] | None = None

    def start(self, line: str) -> None:
        """End the running program by Ctrl-C, start the next, and wait until it is ready."""
        self.end()
        command = [sys.executable, "-m", *shlex.split(line)]
        self._running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._running.stdout is not None
        assert self._running.stdout.readline().startswith("rig ready, 0 V")

    def end(self) -> None:
        """Press Ctrl-C."""
        if self._running is not None:
            self._running.send_signal(signal.SIGINT)
            self._running.communicate(timeout=60)
            self._running = None


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """Give a terminal in an empty folder, which is all of the folders of the person in it."""
    for name in ("RUNTIME_DIR", "DATA_HOME", "CONFIG_HOME", "STATE_HOME"):
        monkeypatch.setenv(f"XDG_{name}", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    lab = Lab()
    yield lab
    lab.end()


@pytest.mark.timed
def test_every_line_that_needs_a_rig_is_a_valid_command(lab: Lab) -> None:
    names: dict[str, Any] = {}
    done: list[str] = []
    said: list[str] = []

    for language, text in BLOCKS:
        if language == "toml":
            Path("chassis.toml").write_text(text)
        if language == "python" and "Rig(" in text:
            exec(compile(_shorter(text), str(PAGE), "exec"), names)
        for line in text.splitlines() if language == "sh" else ():
            if line.startswith(INSTALLED) or line.split()[1] not in LIVE:
                continue
            if line == CONTROL:
                arm = armrig.physics.arm(armrig.physics.ArmParameters())
                law = armrig.control.place(arm, [-18 + 18j, -18 - 18j, -42], rate=True, Ts=0.01)
                Path("law.json").write_bytes(law.text)
            if line.split()[1] == "lab":
                lab.start(line)
            else:
                said.append(_run(_shorter(line)))
            done.append(line.split()[1])

    assert done == [
        *("lab", "status", "calibrate", "collect", "collect"),
        *("lab", "collect", "lab", "collect"),
    ]
    (shown,) = (text for _, text in BLOCKS if text.startswith("motor_rad_per_s_v"))
    (measured,) = (line for line in "".join(said).splitlines() if line.startswith(shown.split()[0]))
    assert pages.numbers(measured)[0] == pytest.approx(pages.numbers(shown)[0], rel=0.01)
    report = re.search(r"^armrig report --handout (@.+?) --answers", TEXT, re.MULTILINE)
    assert report is not None
    read = [armrig.load(recording_path(name)) for name in report[1].split()]
    assert {found.about for found in all_doubts(read, one_plant=False)} <= {"samples"}
    files = sorted(path.name.split("-2")[0] for path in names["path"].parent.glob("*.mcap"))
    assert files == [
        *("1-blackbox-monday", "1-blackbox-tuesday", "1-blackbox-validation-monday"),
        *("1-calibrate-rest", "1-calibrate-turns", "1-control-loop"),
        *("1-greybox-chassis", "1-step-first"),
    ]


@pytest.mark.timed
def test_every_line_of_the_closed_loop_prints_what_the_page_shows(lab: Lab) -> None:
    """The emulated rig gave the lines of the page; their words are the same each time.

    The model is that of the example recording, and another test typesets the report.
    """
    elsewhere = ("armrig report", "armrig collect blackbox", "armrig identify")
    signals = armrig.example_recording().signals()
    orders: dict[str, Any] = {"nb": [[4], [3]], "nf": 3, "shared": "denominator"}
    armrig.oe(signals, integrator="theta_1", **orders).save("model.json")
    text = (pages.DOCS / "close-the-loop.md").read_text(encoding="utf-8")
    shorter = dict(re.findall(r'<!-- the test has "(.+?)" as "(.+?)" -->', text))
    said: list[str] = []

    lab.start("armrig lab --no-dashboard")
    for language, block in re.findall(r"```(sh|text)\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            for long, short in shorter.items():
                line = line.replace(long, short)
            if line.startswith(elsewhere):
                continue
            if language == "sh":
                said += [pages.without_numbers(x) for x in _run(line, both=True).splitlines()]
            else:
                assert pages.without_numbers(line) in said

    assert len(list(Path().rglob("*-control-*.mcap"))) == 2


def _run(line: str, *, both: bool = False) -> str:
    """Run a command and return its output, with `both` also that on standard error."""
    command = [sys.executable, "-m", *shlex.split(line)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, f"{line}: {done.stderr}"
    return done.stdout + done.stderr if both else done.stdout
