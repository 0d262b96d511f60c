"""How sure a grey-box estimate is: noise, what was held fixed, and how it is named."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.physics.grey_box.least_squares_problem import Linearised
from armrig.physics.grey_box.parameters import COULOMB, SIGNED

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def determined(Psi: Matrix) -> Basis:
    """Return the basis of the derivatives, or refuse parameters that stand in for each other."""
    basis = orthonormal(Psi)
    if basis.rank < Psi.shape[1]:
        raise InputError(
            f"the data determine only {basis.rank} of {Psi.shape[1]} parameters, some stand in "
            "for each other: hold more of them fixed"
        )
    return basis


def by_experiment(
    experiments: tuple[Dataset, ...], at: Linearised
) -> tuple[list[Vector], list[Matrix], list[Matrix]]:
    """Return residuals, derivatives and free responses of each experiment, on all its rows."""
    masks = [d.valid for d in experiments]
    edges = np.cumsum([0, *(np.count_nonzero(valid) for valid in masks)])
    residuals, blocks = [], []
    for valid, (a, b) in zip(masks, pairwise(edges), strict=True):
        e = np.full(valid.size, np.nan)
        e[valid] = at.e[a:b]
        residuals.append(e)
        blocks.append(_spread(at.Psi[a:b], valid))
    spans = [_spread(Q, valid) for Q, valid in zip(at.spans, masks, strict=True)]
    return residuals, blocks, spans


def _spread(rows: Matrix, valid: NDArray[np.bool_]) -> Matrix:
    """Return the rows where they belong, and zeros between."""
    whole = np.zeros((valid.size, rows.shape[1]))
    whole[valid] = rows
    return whole


def scales(names: Sequence[str], values: dict[str, float]) -> Vector:
    """Return d parameter / d coordinate."""
    return np.array([1.0 if x in SIGNED | {COULOMB} else values[x] for x in names])


def named_std(names: tuple[str, ...], covariance: Matrix) -> dict[str, float]:
    """Return standard deviations by name."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return dict(zip(names, std.tolist(), strict=True))


def named_influence(
    names: tuple[str, ...], held: tuple[str, ...], influence: Matrix
) -> dict[str, dict[str, float]]:
    """Return d ln estimate / d ln fixed by names, where both have logarithms."""
    return {
        name: {
            k: float(v) for k, v in zip(held, row, strict=True) if k not in SIGNED and abs(v) > 1e-9
        }
        for name, row in zip(names, influence, strict=True)
        if name not in SIGNED | {COULOMB}
    }
