"""The model in a file of `armrig identify --save`, as the emulator and the rehearsal run it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import msgspec

from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_text
from armrig_core.process.printable import plural

if TYPE_CHECKING:
    from armrig_core.rig.equations_file import EquationsProcess

Matrix = list[list[float]]
_Rows = list[list[list[float]]]
_Realization = tuple[Matrix, Matrix, Matrix, bool]
_MAX_BYTES = 1 << 24
_MAX_STATES = 400  # a delay of n samples needs n states
_MIN_TS_S = 1e-4  # the emulator makes each step of the model
_MAX_DELAY_S = 3600.0
_MAX_CONDITION = 1e12  # of I - A, or of A in continuous time; larger with an integrator


class System(NamedTuple):
    """A linear system: x' = A x + B v, or x(t + Ts) = A x + B v; y = C x, v = u - rest_v in V."""

    A: Matrix
    B: Matrix
    C: Matrix
    Ts: float | None
    """Sampling time of a model in discrete time, in s; None for continuous time."""
    delay_s: float = 0.0
    """Dead time of the input, in s."""
    process: EquationsProcess | None = None
    """Process of own equations, whose small motions the matrices describe; otherwise None."""
    rest: Sequence[float] = ()
    """Outputs at rest, if they follow from the model; otherwise empty."""


class _SavedMatrices(msgspec.Struct, tag_field="kind", tag="matrices"):
    """State-space model of one sampling time."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    nk: list[int]


class _SavedPolynomials(msgspec.Struct, tag_field="kind", tag="polynomials"):
    """Polynomials in q^-1, a row for each output."""

    A: _Rows
    B: _Rows
    F: _Rows


class _SavedTransferFunction(msgspec.Struct, tag_field="kind", tag="transfer function"):
    """Polynomials in s, highest power first."""

    B: _Rows
    F: _Rows
    delay: float


class _Free(msgspec.Struct):
    offset: float = 0.0


class _Saved(msgspec.Struct):
    """The fields of the file that are used."""

    format: Literal["armrig model"]
    outputs: list[str]
    input_units: list[str]
    Ts: float
    form: _SavedMatrices | _SavedPolynomials | _SavedTransferFunction
    inputs: tuple[str, ...] = ("u",)
    free: list[_Free] = []


def read_system(
    path: Path,
    outputs: Sequence[str],
    input: tuple[str, str] = ("u", "V"),
    to_unit: Callable[[float], float] = lambda u: u,
    rest_v: float = 0.0,
) -> System:
    """Return the model in a file for a rig with these outputs.

    `input` is the name and the unit of the rig's input, and `to_unit` returns its value at a
    voltage of
    the pin. A model of this input is converted; a model of another input has the voltage itself.

    Raises
    ------
    FileError
        The file contains no model, or a model that has other signals or a direct term.
    """
    try:
        return _system(read_text(path, _MAX_BYTES), tuple(outputs), input, to_unit, rest_v)
    except OSError as err:
        raise FileError(f"model.file = '{path}': {err.strerror}") from err
    except FileError as err:
        raise FileError(f"model.file = '{path}': {err}") from err
    except (ValueError, IndexError, RecursionError) as err:
        raise FileError(f"model.file = '{path}': a damaged model; save it again") from err


def _system(
    text: str,
    outputs: tuple[str, ...],
    input: tuple[str, str],
    to_unit: Callable[[float], float],
    rest_v: float,
) -> System:
    """Return the model in the text of a file; raise ValueError or IndexError if it is damaged."""
    if '"armrig model"' not in text:
        raise FileError("no model; `armrig identify --save` writes a model")
    saved = msgspec.json.decode(text, type=_Saved)
    if tuple(saved.outputs) != outputs or len(saved.input_units) != 1:
        raise FileError(
            f"a model of {', '.join(saved.outputs)}; the rig has one input and the outputs "
            f"{', '.join(outputs)}, so identify these outputs together: --signal "
            f"{','.join(outputs)}"
        )
    Ts: float | None = saved.Ts or None  # 0 in continuous time
    if Ts is not None and not _MIN_TS_S <= Ts < inf:
        raise FileError(f"Ts = {Ts:g} s: at least {_MIN_TS_S:g} s is allowed")
    form, delay_s = saved.form, 0.0
    if isinstance(form, _SavedMatrices):
        if form.nk[0] > 1:
            raise FileError(f"nk = {form.nk[0]}: identify with nk=1, and give model.delay_s")
        A, B, C, direct = form.A, form.B, form.C, any(x for row in form.D for x in row)
        _check_states(len(A))
    elif isinstance(form, _SavedTransferFunction):
        delay_s, F, b = form.delay, form.F[0][0], form.B[0][0]
        A, B, C, direct = _companions([(F, [0.0] * (len(F) - len(b)) + b)])
    else:
        A, B, C, direct = _companions([_quotient(form, i) for i in range(len(form.A))])
    if direct:
        raise FileError("the input acts at once (nk=0); use nk >= 1")
    shapes = ((A, len(A), len(A)), (B, len(A), 1), (C, len(outputs), len(A)))
    fits = all(len(M) == n and all(len(row) == m for row in M) for M, n, m in shapes)
    finite = all(isfinite(x) for M, *_ in shapes for row in M for x in row)
    if not (fits and finite and 0 <= delay_s <= _MAX_DELAY_S):
        raise InputError("its fields do not match each other")
    pair = saved.inputs[0], saved.input_units[0]
    if pair != input and pair[1] not in ("", "V"):
        raise FileError(
            f"a model of the input {pair[0]} [{pair[1]}]; the rig's is {input[0]} [{input[1]}], or "
            "V at the pin"
        )
    scale, at_rest = 1.0, rest_v
    if pair == input:
        scale, at_rest = to_unit(1.0) - to_unit(0.0), to_unit(rest_v)
    rest_y: list[float] = []
    u = at_rest - (saved.free[0].offset if saved.free else 0.0)
    if u:
        import numpy as np

        M = -np.array(A) if Ts is None else np.eye(len(A)) - np.array(A)
        if np.linalg.cond(M) < _MAX_CONDITION:
            rest_y = (np.array(C) @ np.linalg.solve(M, np.array(B)[:, 0] * u)).tolist()
    B = [[scale * b] for (b,) in B]
    return System(A, B, C, Ts, delay_s, rest=rest_y)


def _check_states(n: int) -> None:
    if not 1 <= n <= _MAX_STATES:
        raise FileError(f"the model has {plural(n, 'state')}; 1 to {_MAX_STATES} are allowed")


def _quotient(form: _SavedPolynomials, i: int) -> tuple[list[float], list[float]]:
    """Return the denominator and the numerator of an output, with as many coefficients."""
    import numpy as np  # here, because a description without a saved model is read without numpy

    row, F, b = form.A[i], form.F[i][0], form.B[i][0]
    if any(any(a) for k, a in enumerate(row) if k != i):
        raise FileError("the outputs act on each other (A); identify oe or n4sid instead")
    _check_states(
        max(len(row[i]) + len(F), len(b) + 1) - 2
    )  # first: a product of long ones is slow
    denominator = np.convolve(row[i], F).tolist()
    n = max(len(denominator), len(b))
    return denominator + [0.0] * (n - len(denominator)), b + [0.0] * (n - len(b))


def _companions(quotients: list[tuple[list[float], list[float]]]) -> _Realization:
    """Return A, B, C with a companion matrix for each output, and True for a direct term."""
    total = sum(len(F) - 1 for F, _ in quotients)
    _check_states(total)
    if any(F[0] != 1 or len(F) != len(b) for F, b in quotients):
        raise InputError("a denominator must begin with 1, and be no shorter than the numerator")
    A: Matrix = []
    B: Matrix = []
    C: Matrix = []
    first = 0
    for F, b in quotients:
        # Observer form: x_j(t+1) = -f_j x_1 + x_(j+1) + b_j u, y = x_1; in s, x_j' on the left.
        n = len(F) - 1
        for j in range(n):
            line = [0.0] * total
            line[first] = -F[j + 1]
            if j + 1 < n:
                line[first + j + 1] = 1.0
            A.append(line)
            B.append([b[j + 1]])
        C.append([float(k == first) for k in range(total)])
        first += n
    return A, B, C, any(b[0] for _, b in quotients)
