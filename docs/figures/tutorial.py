"""Draws the figures of docs/tutorial.md beside itself, by commands of the page on its recordings.

The recordings are an emulated rig's, in virtual time, under the names that `armrig collect` gives.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import armrig
from armrig.cli import main as run
from handout import experiments

FOLDER = Path(__file__).parent
TELEGRAPH: dict[str, Any] = {"input": "telegraph", "a": 0.05, "low": 0.5, "high": 4.5}
DRAWN = {
    "tutorial-data.svg": ["plot", "@monday"],
    "tutorial-hints.svg": ["hints", "@monday"],
    "tutorial-residuals.svg": ["validate", "@monday/validation", "--model", "oe.json"],
    "tutorial-chassis.svg": ["greybox", "@chassis"],
}


def record_all(folder: Path) -> None:
    """Record what the page has collected once its collecting commands were given."""
    step = {"input": "step", "low": 0.5, "high": 4.5, "at": 1.0}
    _record(folder, "step-first", "0000000a", armrig.step(5000, at=500), 0.002, 1, step)
    for seed, name, run_id in (
        (1, "blackbox-monday", "0000000b"),
        (2, "blackbox-validation-monday", "0000000c"),
        (3, "greybox-chassis", "0000000d"),
    ):
        details = {**TELEGRAPH, "seed": seed}
        if "validation" in name:
            details["validation_of"] = "0000000b"
        u = armrig.telegraph(3000, 0.05, seed=seed)
        _record(folder, name, run_id, u, 0.01, seed, details)


def _record(
    folder: Path, experiment: str, run_id: str, u: Any, Ts: float, seed: int, details: Any
) -> None:
    minute = int(run_id, 16)
    experiments().record(
        folder / f"1-{experiment}-20260101T13{minute:02}00-{run_id}.mcap",
        *(u, Ts, experiment, seed),
        arm_removed="greybox" in experiment,
        run_id=run_id,
        started=f"2026-01-01T13:{minute:02}:00+00:00",
        details=details,
    )


def main() -> None:
    """Draw all of them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record_all(folder)
        os.environ["ARMRIG_RECORDING_DIRECTORY"] = name
        os.chdir(folder)
        model = ["--structure", "oe", "--integrator", "--save", "oe.json"]
        done = [run(["identify", "@monday", *model])]
        done += [run([*command, "-o", str(FOLDER / file)]) for file, command in DRAWN.items()]
        if any(done):
            raise RuntimeError(f"a command of the page was refused: exit codes {done}")


if __name__ == "__main__":
    main()
