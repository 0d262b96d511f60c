"""`armrig demo --virtual`: on any system with Python, and the same bytes for the same seed."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import armrig
import pytest
from armrig.recordings.files.replay import replay

# Found by every Python below, that of `armrigd virtual` too: a system without POSIX's terminals,
# and without those modules of ours that call Linux.
ELSEWHERE = """
import os, signal, sys

THEIRS = "fcntl", "pty", "termios", "tty", "resource", "grp", "zenoh", "serial"
OURS = "armrig_core.process.waiting", "armrig_core.process.realtime", "armrig_daemon.loop.process"

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


def _demo(folder: Path, *more: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run the demonstration, with seed 7."""
    program = [sys.executable, "-m", "armrig", "demo", "--virtual", "--seconds", "5", "--seed", "7"]
    done = subprocess.run(
        [*program, "--directory", str(folder), *more],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **environ},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def _made(folder: Path) -> dict[str, bytes]:
    """Return the made files, by name, without the configuration and the list of the files."""
    named = (p for p in folder.iterdir() if p.suffix not in {".toml", ".sha256"})
    return {p.name: p.read_bytes() for p in named}


@pytest.mark.exhaustive
def test_the_same_seed_gives_the_same_bytes_anywhere(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    said = _demo(tmp_path).stderr
    hidden = tmp_path_factory.mktemp("elsewhere")
    (hidden / "sitecustomize.py").write_text(ELSEWHERE)
    path = os.pathsep.join([str(hidden), *filter(None, sys.path)])
    odd = {"PYTHONPATH": path, "TZ": "Asia/Tokyo", "PYTHONHASHSEED": "3"}
    told = json.loads(_demo(hidden / "anöther folder", "--json", **odd).stdout)
    here, there = _made(tmp_path), _made(hidden / "anöther folder")

    assert sorted(here) == sorted(there)
    assert [name for name in here if here[name] != there[name]] == []
    kinds = [Path(name).suffix for name in here]
    assert (kinds.count(".mcap"), kinds.count(".svg"), kinds.count(".pdf")) == (3, 7, 1)
    paths = sorted(tmp_path.glob("*.mcap"))
    recordings = [armrig.load(p) for p in paths]
    assert {r.manifest.host["time"] for r in recordings} == {"virtual"}
    assert [r.samples.size for r in recordings if r.manifest.experiment == "blackbox"] == [500, 500]
    assert all(r.missing == 0 for r in recordings)
    assert all(not replay(p).difference for p in paths)
    seeds = {r.manifest.details["seed"] for r in recordings if r.manifest.experiment == "blackbox"}
    assert 7 in seeds
    assert re.search(r"^next: .*report\.pdf", said, re.MULTILINE)
    assert list(told["recordings"]) == ["step", "telegraph", "validation"]
    assert told["in_virtual_time"] == list(told["recordings"])
    assert all(Path(p).exists() for p in [*told["figures"], told["report"]])
