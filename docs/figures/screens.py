"""Screens of the pages: the dashboard while a run is recorded, and a terminal, in light and dark.

`python docs/figures/screens.py [FOLDER]`, in the checkout. It needs Chromium.
"""

from __future__ import annotations

import os
import pty
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import DIMMED_MONOKAI, TerminalTheme
from rich.text import Text

ROOT = Path(__file__).parents[2]
WIDTH = 80
PAUSE_MS = 2000
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
    """Take the pictures of the dashboard during a run."""
    sys.path.insert(0, str(ROOT))
    from playwright.sync_api import sync_playwright

    from tests.integration.processes import Bench
    from tests.integration.watching import begin, watched

    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as playwright:
        bench = Bench(Path(temporary))
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        try:
            bench.emulate()
            bench.serve()
            with watched(bench) as client:
                client.wait("live", lambda seen: not seen["is_stale"])
                begin(client, bench)
                page = browser.new_page(viewport={"width": 1024, "height": 700})
                page.goto(client.url)
                page.wait_for_selector(".pill:not(:has-text('connecting'))")
                for theme, name in (("light", "dashboard.png"), ("dark", "dashboard-dark.png")):
                    page.emulate_media(color_scheme=theme)
                    page.wait_for_timeout(PAUSE_MS)
                    page.screenshot(path=folder / name)
        finally:
            browser.close()
            bench.end()


if __name__ == "__main__":
    into = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "figures"
    terminal(into)
    dashboard(into)
