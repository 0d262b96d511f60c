"""A student's laptop, where there is no rig: Windows and macOS lack what the daemon needs.

A process of its own hides it all, and does with a recording what a student does.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import armrig
import pytest

from tests.clients.made_recordings import of_the_arm, written

_HIDDEN = """
import importlib.abc, os, signal, sys

for name in ("SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT"):
    for module in (signal, sys.modules["_signal"]):
        vars(module).pop(name, None)
for name in [n for n in dir(os) if n.startswith("sched_")]:
    delattr(os, name)
for name in ("getuid", "fork", "mkfifo", "O_NONBLOCK", "O_NOCTTY", "pipe2"):
    delattr(os, name)

class Hidden(importlib.abc.MetaPathFinder):
    names = {
        "grp", "pwd", "fcntl", "termios", "tty", "pty", "resource", "zenoh",
    }
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

for name in Hidden.names:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Hidden())
"""
_COMMAND = _HIDDEN + "from armrig.cli import main\nsys.exit(main(sys.argv[1:]))\n"
_COMMANDS = (
    _HIDDEN
    + """
import json
from armrig.cli import main
for arguments in json.loads(sys.argv[1]):
    if main(arguments):
        sys.exit(f"refused: {arguments}")
"""
)
_TYPED = """
import armrig
rec = armrig.load(sys.argv[1], start=1.0)
assert armrig.arx(rec.dataset(), na=2, nb=2).names
print("loaded", rec.N)
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording in a path with blanks and letters of all kinds."""
    folder = tmp_path_factory.mktemp("laptop") / "Mes données – Übung 3"
    folder.mkdir()
    return written(folder, of_the_arm(armrig.telegraph(1500, 0.05, low=0.5, high=4.5, seed=1)))


def on_a_laptop(program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a program there."""
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "COLUMNS": "200"},
    )


def test_python_loads_and_identifies(run: Path) -> None:
    done = on_a_laptop(_HIDDEN + _TYPED, run)

    assert done.returncode == 0, done.stderr
    assert done.stdout == "loaded 1400\n"


@pytest.mark.exhaustive
def test_the_commands_of_a_student_work(run: Path) -> None:
    folder = run.parent
    model, table, matrices = folder / "modèle 1.json", folder / "données.csv", folder / "run.mat"
    orders = ("--structure", "arx", "--na", "4", "--nb", "4")
    typed = (
        ("info", run),
        ("export", run, table),
        ("export", run, matrices, "--from", "2", "--to", "10"),
        ("identify", run, *orders, "--save", model),
        ("validate", run, "--model", model),
        ("identify", table, "--signal", "theta_1", *orders),
        ("report", run, "-o", folder / "compte rendu.pdf"),
    )

    done = on_a_laptop(_COMMANDS, json.dumps([[str(word) for word in line] for line in typed]))

    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert (folder / "compte rendu.pdf").read_bytes().startswith(b"%PDF")


def test_files_are_verified_identified_and_recovered(run: Path) -> None:
    table, left = run.with_name("Messung März.csv"), run.with_name("kopie.mcap.active")
    rows = [f"{k / 100:.2f};{k % 7};{(k * k) % 11 / 2}".replace(".", ",") for k in range(200)]
    table.write_bytes("\r\n".join(["t;u;y", *rows, ""]).encode())
    left.write_bytes(run.read_bytes()[:-1000])
    orders = ("--structure", "arx", "--na", "2", "--nb", "2")
    typed = (("verify", run), ("identify", table, *orders), ("recover", left))

    done = on_a_laptop(_COMMANDS, json.dumps([[str(word) for word in line] for line in typed]))

    assert done.returncode == 0, done.stderr
    assert "passed" in done.stdout
    assert "200 samples, 0.01 s apart" in " ".join(done.stderr.split())
    assert not left.exists()
    assert not armrig.load(left.with_suffix("")).truncated


@pytest.mark.parametrize("command", ["doctor", "status"])
def test_a_command_for_linux_is_refused_in_one_line(command: str) -> None:
    done = on_a_laptop(_COMMAND, command)

    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "needs Linux" in " ".join(done.stderr.split())
