"""A daemon on one machine, and the programs of others that try it from another."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.integration.namespaces import Namespaces
from tests.integration.processes import Bench, wait_for

HERE = Path(__file__).parent
GUARDED = ("-m", "armrig_daemon")
"""Program of the daemon."""
UNGUARDED = (str(HERE / "unguarded.py"),)
"""And of that which denies nothing."""
STRANGER = "tests.integration.stranger"
PORT = 7447
WITHIN_S = 120


@contextmanager
def started(line: Namespaces, bench: Bench, *program: str) -> Iterator[Path]:
    """Have a daemon run on the rig's side; give its log."""
    log = bench.folder / "log"
    command = [sys.executable, *program, "run", "--config", str(bench.config)]
    with log.open("wb") as stderr:
        daemon = subprocess.Popen(
            ["env", f"XDG_RUNTIME_DIR={bench.folder}", *line.command("rig", *command)],
            stderr=stderr,
        )
    try:
        wait_for(lambda: bench.phase() == "safe" or daemon.poll() is not None, WITHIN_S)
        assert daemon.poll() is None, log.read_text()
        yield log
    finally:
        daemon.terminate()
        assert daemon.wait(WITHIN_S) == 0


def stranger(
    line: Namespaces, where: str, made: Path, who: str, pem: str, program: str = STRANGER
) -> subprocess.Popen[str]:
    """Start a program on the strangers' side."""
    credential = [str(made / pem)] if pem else []
    return subprocess.Popen(
        line.command(
            "stranger",
            *(sys.executable, "-m", program),
            *(where, str(made / "authority.pem"), who, *credential),
        ),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=HERE.parents[1],
    )


@contextmanager
def watching(line: Namespaces, where: str, made: Path) -> Iterator[subprocess.Popen[str]]:
    """Have an operator listen, from the strangers' side, until the block ends."""
    watcher = stranger(line, where, made, "watch", "carol.pem")
    assert watcher.stdout is not None
    assert watcher.stdout.readline() == "there\n"
    yield watcher


def said(program: subprocess.Popen[str]) -> Any:
    """End a program's input, and return the JSON of its output."""
    text, _ = program.communicate(timeout=WITHIN_S)
    assert program.returncode == 0
    return json.loads(text)
