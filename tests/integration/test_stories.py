"""Output of commands and the daemon's log during work at a rig, word for word.

A file in `stories/` is a script and its stored output. A line that begins with `$` is a command, a
line with `%` an event of the rig. The other lines are the output. Words are compared exactly;
numbers, names of recordings and folders are not. `make stored` writes the files again: read the
difference before you commit it.
"""

from __future__ import annotations

import getpass
import os
import re
import shlex
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.integration.driving import driven, recorded
from tests.integration.processes import Bench, wait_for

STORIES = sorted(Path(__file__).with_name("stories").glob("*.txt"))
_OF_A_RUN = re.compile(r"\d{8}T\d{6}|\b[0-9a-f]{8,}\b|\d{4}-\d\d-\d\dT[\d:.+]+")
_CLOSED = re.compile("end of file|Connection reset by peer|Broken pipe")  # as it comes
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
_BAR = re.compile(r"^\S+ +━.*", re.MULTILINE)
_OF_THIS_HOST = re.compile(
    r'^(armrigd: warning: not granted|host  ).*\n|"host":{[^}]*},', re.MULTILINE
)


class Stage:
    """A rig with its daemon, and the events of a story."""

    def __init__(self, bench: Bench, stack: ExitStack) -> None:
        self._bench = bench
        self._emulator = bench.emulate()
        self._daemon = bench.serve()
        self._logged = 0
        self._stack = stack

    def command(self, line: str) -> str:
        """Return the output of a command, and its exit code unless that is 0."""
        program, *arguments = shlex.split(line.replace("LAST", self._last()))
        assert program == "armrig", line
        done = self._bench.armrig(*arguments)
        ended = f"exit {done.returncode}\n" if done.returncode else ""
        return done.stdout + done.stderr + ended

    def act(self, what: str) -> str:
        """Apply an event to the rig; return the daemon's log since the last `log`."""
        match what:
            case "log":
                text = self._daemon.said
                since, self._logged = text[self._logged :], len(text)
                return since
            case "drive":
                self._stack.enter_context(driven(self._bench, 6000))
            case "unplug":
                self._emulator.end()
                wait_for(lambda: "cannot be opened" in self._daemon.said)  # half a second later
            case "plug in":
                self._emulator = self._bench.emulate()
                wait_for(self._answers)
            case "finish":
                recorded(self._bench)
            case "end":
                assert self._daemon.end() == 0
            case _:
                raise AssertionError(what)
        return ""

    def _answers(self) -> bool:
        with self._bench.rig() as rig:
            return not rig.status().line

    def _last(self) -> str:
        found = self._bench.recordings.glob("*.mcap")
        return str(max(found, key=lambda path: path.stat().st_mtime_ns, default=""))


def plain(text: str, folder: Path) -> str:
    """Return a text without folder, user and host."""
    text = text.replace(str(folder), "FOLDER").replace(f"by {getpass.getuser()}", "by USER")
    return _BAR.sub("(bar)", _OF_THIS_HOST.sub("", text))


def words(text: str, folder: Path) -> list[str]:
    """Return the lines of a text, `#` in place of what differs from run to run."""
    text = _CLOSED.sub("closed", _NUMBER.sub("#", _OF_A_RUN.sub("#", plain(text, folder))))
    lines = [line.rstrip() for line in text.splitlines()]
    for i, line in enumerate(lines[:-1]):
        # The disk's speed decides which of the two comes first.
        if "warning: no link" in line and "info: recorded" in lines[i + 1]:
            lines[i : i + 2] = lines[i + 1], line
    return lines


def told(script: str, stage: Stage) -> str:
    """Return a story: the lines of a script, with the output after each."""
    parts = []
    for line in script.splitlines(keepends=True):
        if line.startswith("$ "):
            parts.append(line + stage.command(line[2:].strip()))
        elif line.startswith("% "):
            parts.append(line + stage.act(line[2:].strip()))
        elif line.startswith("# "):
            parts.append(line)
    return "".join(parts)


@pytest.mark.exhaustive
@pytest.mark.parametrize("story", STORIES, ids=lambda story: story.stem)
def test_a_story_is_printed_word_for_word(bench: Bench, story: Path) -> None:
    stored = story.read_text()
    with ExitStack() as stack:
        now = told(stored, Stage(bench, stack))

    found, wanted = words(now, bench.folder), words(stored, bench.folder)
    if os.environ.get("WRITE_STORED") and found != wanted:
        story.write_text(plain(now, bench.folder))
    else:
        assert found == wanted
