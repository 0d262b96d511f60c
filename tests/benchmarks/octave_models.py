"""Octave's n4sid (SLICOT) and arx on the same records, where Octave and its package control are."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
_SCRIPT = Path(__file__).with_suffix(".m")


@dataclass(frozen=True, slots=True, kw_only=True)
class OctaveModel:
    """One model A y = B u + C e, or why there is none."""

    record: int
    method: str
    order: int
    A: Vector
    B: Vector
    C: Vector
    failed: str = ""


def have_octave() -> bool:
    """Return whether Octave can be called."""
    return shutil.which("octave-cli") is not None


def octave_models(
    records: Sequence[tuple[Vector, Vector]], orders: Iterable[int], methods: Sequence[str]
) -> list[OctaveModel]:
    """Return the models of all records (u, y), which are of one length."""
    from scipy.io import savemat

    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "in.mat", Path(folder) / "out.txt"
        savemat(
            file,
            {
                "U": np.column_stack([u for u, _ in records]),
                "Y": np.column_stack([y for _, y in records]),
                "orders": np.array([*orders], dtype=float),
                "methods": np.array([*methods], dtype=object),
            },
        )
        command = ["octave-cli", "--no-gui", "--quiet", str(_SCRIPT), str(file), str(out)]
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        return [_parsed(line) for line in out.read_text().splitlines()]


def _parsed(line: str) -> OctaveModel:
    head, *rest = line.split(";")
    record, method, order = head.split()
    none = np.zeros(0)
    if len(rest) == 1:
        A = B = C = none
        failed = rest[0]
    else:
        A, B, C = (np.array(p.split(), dtype=float) for p in rest)
        failed = ""
    return OctaveModel(
        record=int(record), method=method, order=int(order), A=A, B=B, C=C, failed=failed
    )
