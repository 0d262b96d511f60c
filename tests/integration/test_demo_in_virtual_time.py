"""`armrig demo --virtual`: on any system with Python, and the same bytes for the same seed."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import armrig
from armrig.cli.replay import replay

# Found by every Python below, that of `armrigd virtual` too: a system without POSIX's terminals,
# and without those modules of ours that call Linux.
ELSEWHERE = """
import os, signal, sys

THEIRS = "fcntl", "pty", "termios", "tty", "resource", "grp", "zenoh", "serial"
OURS = "armrig_core.waiting", "armrig_daemon.loop.realtime", "armrig_daemon.loop.process"

class Nowhere:
    def find_spec(self, name, path=None, target=None):
        if name in THEIRS + OURS:
            raise ImportError(f"{name} is not there")

for name in ("fcntl", "pty", "termios", "tty"):
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Nowhere())
for name in ("SIGHUP", "SIGPIPE"):
    delattr(signal, name)
for name in ("fdatasync", "openpty", "getuid", "mkfifo", "pipe2"):
    delattr(os, name)
"""


def _demo(folder: Path, seed: int, **environ: str) -> dict[str, bytes]:
    """Run the demonstration; return what it made, by name, but its configuration."""
    program = [sys.executable, "-m", "armrig", "demo", "--virtual", "--seconds", "5"]
    done = subprocess.run(
        [*program, "--seed", str(seed), "--directory", str(folder)],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **environ},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (telegraph,) = re.findall(r"^next: armrig plot (\S.*) -o data.png$", done.stderr, re.MULTILINE)
    (path,) = shlex.split(telegraph)
    assert armrig.load(path).manifest.details["seed"] == seed
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.suffix != ".toml"}


def test_the_same_seed_gives_the_same_bytes_anywhere(tmp_path: Path) -> None:
    """Recordings, figures and report; without terminals, locks or SIGHUP, and in another zone."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "sitecustomize.py").write_text(ELSEWHERE)
    path = os.pathsep.join([str(tmp_path / "elsewhere"), *filter(None, sys.path)])

    here = _demo(tmp_path / "one", 7)
    elsewhere = _demo(
        *(tmp_path / "anöther folder", 7),
        **{"PYTHONPATH": path, "TZ": "Asia/Tokyo", "PYTHONHASHSEED": "3"},
    )

    assert sorted(here) == sorted(elsewhere)
    assert [name for name in here if here[name] != elsewhere[name]] == []
    kinds = [Path(name).suffix for name in here]
    assert (kinds.count(".mcap"), kinds.count(".svg"), kinds.count(".pdf")) == (3, 8, 1)
    paths = sorted((tmp_path / "one").glob("*.mcap"))
    recordings = [armrig.load(p) for p in paths]
    assert {r.manifest.host["time"] for r in recordings} == {"virtual"}
    assert [r.samples.size for r in recordings if r.manifest.experiment == "blackbox"] == [500, 500]
    assert all(r.missing == 0 for r in recordings)
    assert all(not replay(p).difference for p in paths)


def test_a_program_is_told_where_everything_lies(tmp_path: Path) -> None:
    """One line of JSON on standard output; what a person reads is beside it."""
    program = [sys.executable, "-m", "armrig", "demo", "--virtual", "--seconds", "5", "--json"]
    done = subprocess.run(
        [*program, "--directory", str(tmp_path)], capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert list(found["recordings"]) == ["step", "telegraph", "validation"]
    assert found["in_virtual_time"] == list(found["recordings"])
    assert [armrig.load(p).missing for p in found["recordings"].values()] == [0, 0, 0]
    assert [model["model"] for model in found["models"]] == ["ARX", "OE", "physics"]
    assert all(Path(p).exists() for p in [*found["figures"], found["report"]])
    assert "next:" not in done.stderr
