"""Place and size of the texts on the pages of a PDF that typst wrote."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_STREAM = re.compile(rb"<</Length (\d+)/Filter/FlateDecode>>\s*stream\r?\n")
# The operators that place text: of the graphics state, of the matrices, of the font's size.
_OPERATOR = re.compile(
    rb"\((?:\\.|[^\\()])*\)|(?<![\w.])(?P<state>[qQ])(?![\w.])|"
    rb"(?P<numbers>(?:-?[\d.]+ ){6})(?P<matrix>cm|Tm)|(?P<size>-?[\d.]+) Tf",
    re.DOTALL,
)


@dataclass(frozen=True, slots=True)
class Text:
    """A text of a page; its size and its distance from the lower edge, in points."""

    size: float
    y: float


def pages(path: Path) -> list[list[Text]]:
    """Return the texts of each page."""
    pdf = path.read_bytes()
    streams = [
        zlib.decompress(pdf[found.end() : found.end() + int(found[1])])
        for found in _STREAM.finditer(pdf)
    ]
    return [_texts(stream) for stream in streams if b"BT" in stream and b" Tf" in stream]


def _texts(stream: bytes) -> list[Text]:
    found: list[Text] = []
    state, states, size = np.eye(3), [], 0.0
    for operator in _OPERATOR.finditer(stream):
        if operator["state"] == b"q":
            states.append(state)
        elif operator["state"] == b"Q":
            state = states.pop()
        elif operator["size"]:
            size = float(operator["size"])
        elif operator["matrix"]:
            matrix = _matrix(operator["numbers"]) @ state
            if operator["matrix"] == b"cm":
                state = matrix
            else:
                found.append(Text(size * abs(np.linalg.det(matrix)) ** 0.5, float(matrix[2, 1])))
    return found


def _matrix(numbers: bytes) -> NDArray[np.float64]:
    a, b, c, d, e, f = map(float, numbers.split())
    return np.array([[a, b, 0.0], [c, d, 0.0], [e, f, 1.0]])


def svg_sizes(path: Path) -> list[float]:
    """Return the sizes of the texts of a figure that matplotlib wrote, in points."""
    return [float(size) for size in re.findall(r"font-size: ([\d.]+)px", path.read_text())]
