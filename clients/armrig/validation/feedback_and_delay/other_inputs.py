"""Data of one channel without the effects of the other inputs, for the test of the delay."""

from __future__ import annotations

from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset, Signals
from armrig.numerics.criteria import mdl
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.regressors import complete, past

_ORDERS = (1, 2, 3, 4, 6, 8, 12, 16)
_ROWS_PER_PARAMETER = 5


def without_other_inputs(data: Signals, output: str, input: str) -> tuple[Dataset, dict[str, Any]]:
    """Return one channel without the effects of the other inputs, and options of `delay`.

    With several inputs, A and all B_k of an ARX model of the output are estimated; MDL chooses the
    order of the model. The signal w contains no effects of the other inputs ::

        w = A y - sum of B_k u_k over k other than j = B_j u_j + e

    The first lag of B_j is the lag at which input j acts first. A contains the integrator of an
    output that integrates, so that w does not integrate.
    """
    own = data.dataset(output, input)
    if data.nu == 1:
        return own, {}
    j = data.inputs.index(input)
    parts = list(data.channels([output]).experiments())
    blocks = _best_blocks(parts, output)
    rows = [complete(block) for block in blocks]
    n = (blocks[0].shape[1] - 1 - data.nu) // (1 + data.nu)
    whole = np.vstack([block[known] for block, known in zip(blocks, rows, strict=True)])
    theta = orthonormal(whole[:, :-1]).coefficients(whole[:, -1])
    kept = slice(n + j * (n + 1), n + (j + 1) * (n + 1))
    theta[kept] = 0.0
    w = np.concatenate([block[:, -1] - block[:, :-1] @ theta for block in blocks])
    # Not the output's own name, which can imply an integrator or a smooth onset.
    alone = own.replaced(
        step=None, y=np.nan_to_num(w), valid=np.isfinite(w), output=f"filtered {output}"
    )
    return alone, {"integrator": False}


def _best_blocks(parts: list[Signals], output: str) -> list[Array]:
    """Return the rows [-y lags, u_1 lags, …, y] of each experiment, for the order n with least MDL.

    The rows of an experiment have the shape (N, n + nu (n + 1) + 1).
    """
    best: tuple[float, list[Array]] | None = None
    for n in _ORDERS:
        blocks = [_block(part, n) for part in parts]
        whole = np.vstack([block[complete(block)] for block in blocks])
        d = whole.shape[1] - 1
        if whole.shape[0] < _ROWS_PER_PARAMETER * d:
            break
        e = orthonormal(whole[:, :-1]).without(whole[:, -1])
        score = float(mdl(float(np.mean(e**2)), d, whole.shape[0]))
        if best is None or score < best[0]:
            best = (score, blocks)
    if best is None:
        raise InputError(f"too few samples of {output} for an ARX model of all inputs; record more")
    return best[1]


def _block(part: Signals, n: int) -> Array:
    y = np.where(part.valid[:, 0], part.y[:, 0], np.nan)
    inputs = [past(u, range(n + 1)) for u in part.u.T]
    return np.hstack([-past(y, range(1, n + 1)), *inputs, y[:, None]])
