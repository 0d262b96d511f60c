"""The demonstration in virtual time: `armrigd virtual` plays and records, and nobody waits."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from armrig_core.errors import OperationError

from armrig.cli.demo_plan import Experiment


def record_in_virtual_time(
    plan: Sequence[Experiment],
    directory: Path,
    config: Path,
    *,
    seed: int,
    firmware: bool = False,
    meanwhile: Callable[[], object] = lambda: None,
) -> list[Path]:
    """Play experiments on an emulated rig in virtual time; return their recordings.

    Parameters
    ----------
    config : Path
        Configuration of the rig.
    seed : int
        Of the emulated rig, and of the names and times of its recordings.
    firmware : bool, default False
        The device is the Uno's firmware in simavr.
    meanwhile : callable
        What is done while another processor plays.

    Raises
    ------
    OperationError
        They could not be recorded.
    """
    # Where a pipe is not of UTF-8 by itself, the name of a folder would not come through.
    program = [sys.executable, "-X", "utf8", "-m", "armrig_daemon", "virtual"]
    program += ["--config", str(config), "--directory", str(directory), "--seed", str(seed)]
    program += ["--firmware"] if firmware else []
    # In a file: a pipe would have to be fed while we do something else.
    with tempfile.TemporaryFile() as asked:
        for one in plan:
            asked.write(json.dumps({"u": one.u.tolist(), **one.request}).encode() + b"\n")
        asked.seek(0)
        player = subprocess.Popen(
            program, stdin=asked, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
    try:
        meanwhile()
        said, complaint = player.communicate()
    except BaseException:
        player.kill()
        player.communicate()
        raise
    if player.returncode:
        lines = complaint.decode(errors="replace").strip().splitlines()
        raise OperationError(
            lines[-1] if lines else f"armrigd virtual ended with exit code {player.returncode}"
        )
    return [Path(line) for line in said.decode().splitlines()]
