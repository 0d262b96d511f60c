"""The model in a file of `armrig identify --save`, as the emulator and the rehearsal run it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from armrig_core.errors import FileError
from armrig_core.process.bounded import read_text

Matrix = list[list[float]]
_FORMAT = "armrig model"
_MAX_BYTES = 1 << 24
_MAX_STATES = 400  # of the polynomials; a delay of n samples needs n states


class System(NamedTuple):
    """A linear system of one input: x' = A x + B u, or x(t + Ts) = A x + B u; y = C x."""

    A: Matrix
    B: Matrix
    C: Matrix
    Ts: float | None
    """Sampling time of a model in discrete time, in s; None for continuous time."""


def saved_system(path: Path, outputs: Sequence[str]) -> System:
    """Return the model in a file for a rig with these outputs.

    Raises
    ------
    FileError
        The file contains no model, or a model that has other signals or a direct term.
    """
    try:
        content = json.loads(read_text(path, _MAX_BYTES))
        if not isinstance(content, dict) or content.get("format") != _FORMAT:
            raise FileError("no model; `armrig identify --save` writes a model")
        found, form = tuple(content["outputs"]), content["form"]
        if found != tuple(outputs) or len(content["input_units"]) != 1:
            raise FileError(
                f"a model of {', '.join(map(str, found))}; the rig has one input and the outputs "
                f"{', '.join(outputs)}, so identify these outputs together: --signal "
                f"{','.join(outputs)}"
            )
        A, B, C, direct = _matrices(form) if form["kind"] == "matrices" else _companions(form)
        Ts = float(content["Ts"])
    except OSError as err:
        raise FileError(f"model.file = '{path}': {err.strerror}") from err
    except FileError as err:
        raise FileError(f"model.file = '{path}': {err}") from err
    except (ValueError, KeyError, TypeError, IndexError) as err:
        raise FileError(f"model.file = '{path}': a damaged model; save it again") from err
    if direct:
        raise FileError(f"model.file = '{path}': the input acts at once (nk=0); use nk >= 1")
    if not all(isfinite(x) for matrix in (A, B, C) for row in matrix for x in row):
        raise FileError(f"model.file = '{path}': a number is not finite; save the model again")
    return System(A, B, C, Ts)


def _matrices(form: dict[str, Any]) -> tuple[Matrix, Matrix, Matrix, bool]:
    """Return A, B, C, and True if there is a direct term."""
    if form["nk"][0] > 1:
        raise FileError(f"nk = {form['nk'][0]}: identify with nk=1, and give model.delay_s")
    return form["A"], form["B"], form["C"], any(x for row in form["D"] for x in row)


def _companions(form: dict[str, Any]) -> tuple[Matrix, Matrix, Matrix, bool]:
    """Return a companion matrix for each output, one below the other, on the diagonal."""
    import numpy as np  # here, because a description without a saved model is read without numpy

    A: Matrix = []
    B: Matrix = []
    C: Matrix = []
    blocks = []
    for i, row in enumerate(form["A"]):
        if any(any(a) for k, a in enumerate(row) if k != i):
            raise FileError("the outputs act on each other (A); identify oe or n4sid instead")
        F = np.convolve(row[i], form["F"][i][0]).tolist()
        b = [float(x) for x in form["B"][i][0]]
        n = max(len(F), len(b)) - 1
        blocks.append((F + [0.0] * (n + 1 - len(F)), b + [0.0] * (n + 1 - len(b)), n))
    total = sum(n for *_, n in blocks)
    if not 1 <= total <= _MAX_STATES:
        raise FileError(f"the model has {total} states; 1 to {_MAX_STATES} are allowed")
    first = 0
    for F, b, n in blocks:
        # Observer form: x_j(t+1) = -f_j x_1 + x_(j+1) + b_j u, y = x_1.
        for j in range(n):
            line = [0.0] * total
            line[first] = -F[j + 1]
            if j + 1 < n:
                line[first + j + 1] = 1.0
            A.append(line)
            B.append([b[j + 1]])
        C.append([float(k == first) for k in range(total)])
        first += n
    return A, B, C, any(b[0] for _, b, _ in blocks)
