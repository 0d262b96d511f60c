"""Draws the figure of docs/several-signals.md beside itself, by the commands of the page."""

from __future__ import annotations

import importlib.util
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any

from armrig.cli import main as armrig

FOLDER = Path(__file__).parent


def record_all(folder: Path) -> None:
    """Record the recordings of the handout's page."""
    found = importlib.util.spec_from_file_location("handout", FOLDER / "handout.py")
    if found is None or found.loader is None:
        raise FileNotFoundError(f"{FOLDER / 'handout.py'} is missing; it makes the recordings")
    script: Any = importlib.util.module_from_spec(found)
    found.loader.exec_module(script)
    script.record_all(folder)


def main() -> None:
    """Estimate and validate as on the page, and save the figure."""
    with tempfile.TemporaryDirectory() as name, chdir(name):
        record_all(Path(name))
        both = "identify estimation.mcap --signal theta_1,alpha --structure oe --integrator"
        armrig([*both.split(), "--save", "both.json"])
        figure = FOLDER / "several-signals.svg"
        armrig(["validate", "validation.mcap", "--model", "both.json", "-o", str(figure)])


if __name__ == "__main__":
    main()
