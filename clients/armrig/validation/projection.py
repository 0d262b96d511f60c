"""Residuals of a model, and their projection on the quantities that were estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armrig.models.predictor import PredictionErrors, stack_outputs
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array

_COLUMNS = 8  # columns that are projected at once, so that only a part of a matrix is copied


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Projection:
    """P = B B^T W, the projection on the estimated quantities with the weights W = G^T G.

    The residuals are e = (1 - P) v, with the noise v. B is an orthonormal basis: B^T W B = 1. Its
    columns are S of each experiment, and T, the basis of the effects of the parameters.
    """

    parts: Sequence[PredictionErrors]
    """Residuals of each experiment."""
    T: Sequence[Array]
    """T of each experiment (N, ny, r); without columns if the parameters are from other data."""

    @property
    def rank(self) -> int:
        """Number of estimated quantities."""
        return int(self.T[0].shape[2] + sum(part.S.shape[2] for part in self.parts))

    def remove_states(self, Z: Sequence[Array]) -> None:
        """Subtract W S S^T Z from Z (N, ny, k) of each experiment, in place."""
        for part, z in zip(self.parts, Z, strict=True):
            begun = np.flatnonzero(part.S.any(axis=(1, 2)))
            if begun.size:  # the effect of the unknown past ends early
                some = slice(0, int(begun[-1]) + 1)
                WS = part.weight(part.S)[some]
                _subtract(z[some], WS, sum_of_products([part.S[some]], [z[some]]))

    def remove_parameters(self, Z: Sequence[Array]) -> None:
        """Subtract W T T^T Z from Z (N, ny, k) of each experiment, in place."""
        if not self.T[0].shape[2]:
            return
        c = sum_of_products(self.T, Z)
        for part, z, t in zip(self.parts, Z, self.T, strict=True):
            _subtract(z, part.weight(t), c)

    def influence(self, Z: Sequence[Array]) -> list[Array]:
        """Return H = (1 - P)^T Z (N, ny, k) of each experiment, so that Z^T e is equal to H^T v."""
        H = [z.copy() for z in Z]
        self.remove_states(H)
        self.remove_parameters(H)
        return H

    def applied(self) -> Projection:
        """Return the projection of experiments with the residuals (1 - P) e.

        1 - P removes the difference of e and v, a combination of the columns of B. The residuals
        are therefore (1 - P) v even if e was projected with other weights, or if the search ended
        shortly before its minimum.
        """
        e = [np.nan_to_num(part.e)[:, :, None] for part in self.parts]
        WT = [part.weight(t) for part, t in zip(self.parts, self.T, strict=True)]
        c = sum_of_products(WT, e)
        parts = []
        for part, x, t in zip(self.parts, e, self.T, strict=True):
            by_state = part.S @ sum_of_products([part.weight(part.S)], [x])
            parts.append(replace(part, e=part.e - (by_state + t @ c)[:, :, 0]))
        return replace(self, parts=parts)

    def loss(self, Lambda: Array) -> list[tuple[Array, Array]]:
        """Return B and D of each experiment: cov e is Lambda - B D^T - D B^T if v is white."""
        ends = np.cumsum([part.S.shape[2] for part in self.parts])
        B = []
        for part, t, end in zip(self.parts, self.T, ends.tolist(), strict=True):
            states = np.zeros((*part.e.shape, int(ends[-1])))
            states[:, :, end - part.S.shape[2] : end] = part.S
            B.append(np.concatenate([states, t], axis=2))
        WB = [part.weight(b) for part, b in zip(self.parts, B, strict=True)]
        C = [
            np.einsum("ij,tjr->tir", Lambda, wb) * part.known[:, :, None]
            for part, wb in zip(self.parts, WB, strict=True)
        ]
        M = sum_of_products(WB, C)
        return [(b, c - b @ (0.5 * M)) for b, c in zip(B, C, strict=True)]


def _subtract(z: Array, WB: Array, c: Array) -> None:
    """Subtract WB(t) c from z(t) in place."""
    for i in range(z.shape[1]):
        for a in range(0, z.shape[2], _COLUMNS):
            z[:, i, a : a + _COLUMNS] -= WB[:, i] @ c[:, a : a + _COLUMNS]


def projection(parts: Sequence[PredictionErrors], *, with_parameters: bool) -> Projection:
    """Return the projection on effects of initial states, ramps and, if asked for, parameters."""
    if not with_parameters:
        return Projection(parts=parts, T=[part.S[:, :, :0] for part in parts])
    G = parts[0].Psi.shape[1] > 1
    W = orthonormal(np.vstack([stack_outputs(p.G @ p.Psi if G else p.Psi) for p in parts])).W
    return Projection(parts=parts, T=[part.Psi @ W for part in parts])


def sum_of_products(X: Sequence[Array], Y: Sequence[Array]) -> Array:
    """Return the sum of X(t)^T Y(t) over all experiments, (r, k)."""
    total = np.zeros((X[0].shape[2], Y[0].shape[2]))
    for x, y in zip(X, Y, strict=True):
        for i in range(x.shape[1]):
            total += x[:, i].T @ y[:, i]
    return total
