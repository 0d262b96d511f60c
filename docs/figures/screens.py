"""Screens of the pages: the dashboard while a run is recorded, and a terminal, in light and dark.

`python docs/figures/screens.py [FOLDER]`, in the checkout. It needs Chromium.
"""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import DIMMED_MONOKAI, TerminalTheme
from rich.text import Text

ROOT = Path(__file__).parents[2]
WIDTH = 80
COMMAND = "armrig demo --virtual"
SPINNER = re.compile("[\u2800-\u28ff]")
LIGHT = TerminalTheme(
    (255, 255, 255),
    (34, 34, 34),
    [
        (0, 0, 0),
        (176, 0, 0),
        (0, 110, 0),
        (130, 90, 0),
        (0, 70, 170),
        (130, 0, 130),
        (0, 110, 120),
        (90, 90, 90),
    ],
)
PAGE = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {terminal_width} {terminal_height}">
<style>.{unique_id}-matrix {{ font: {char_height}px monospace }} {styles}</style>
<rect width="100%" height="100%" fill="BACKGROUND"/>
<g class="{unique_id}-matrix">{backgrounds}{matrix}</g></svg>
"""


def typed(command: str, folder: Path) -> str:
    """Return what a terminal shows when a command is typed in a folder."""
    leader, follower = pty.openpty()
    environment = os.environ | {"COLUMNS": str(WIDTH), "TERM": "xterm-256color", "LINES": "60"}
    words = [Path(sys.executable).with_name("armrig"), *command.split()[1:]]
    with subprocess.Popen(
        words, cwd=folder, env=environment, stdin=follower, stdout=follower, stderr=follower
    ):
        os.close(follower)
        shown = b""
        while part := _read(leader):
            shown += part
    os.close(leader)
    lines = (line.rpartition("\r")[2] for line in shown.decode().split("\r\n"))
    return "\n".join(line for line in lines if not SPINNER.search(line))


def _read(leader: int) -> bytes:
    try:
        return os.read(leader, 65536)
    except OSError:  # the end of a terminal whose program has ended
        return b""


def terminal(folder: Path) -> None:
    """Draw a terminal in which the command was typed."""
    with tempfile.TemporaryDirectory() as empty:
        text = f"$ {COMMAND}\n{typed(COMMAND, Path(empty))}"
    for name, theme in (("terminal.svg", LIGHT), ("terminal-dark.svg", DIMMED_MONOKAI)):
        with Path(os.devnull).open("w") as nowhere:
            console = Console(record=True, width=WIDTH, file=nowhere, force_terminal=True)
            console.print(Text.from_ansi(text))
            page = PAGE.replace("BACKGROUND", theme.background_color.hex)
            console.save_svg(str(folder / name), theme=theme, code_format=page, unique_id="screen")


def dashboard(folder: Path) -> None:
    """Take the pictures of the dashboard."""
    with tempfile.TemporaryDirectory() as all_sizes:
        words = [sys.executable, "-m", "tests.benchmarks.screenshots", all_sizes, "running"]
        subprocess.run(words, cwd=ROOT, check=True)
        for theme, name in (("light", "dashboard.png"), ("dark", "dashboard-dark.png")):
            taken = Path(all_sizes, f"running-1024-{theme}.png")
            (folder / name).write_bytes(taken.read_bytes())


if __name__ == "__main__":
    into = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "figures"
    terminal(into)
    dashboard(into)
