"""Covariances, quality and warnings of a grey-box estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from armrig_core.errors import InputError

from armrig.data.columns import Matrix
from armrig.data.treatment.wrong_samples import too_quiet
from armrig.numerics.inference import Inference, OutputResiduals, infer
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.stretches import Mask
from armrig.physics.grey_box.least_squares_problem import Linearised, WeightedData

ROUNDING_SHARE = 1e-18  # share of |y|²; a smaller |e|² is rounding error
_MIN_COMPONENT = 0.05  # least component of a parameter in a combination without effect


def inferred(plain: WeightedData, at: Linearised, basis: Basis) -> Inference:
    """Return covariances of the coordinates, and the quality for each output."""
    ny, begin, experiments = plain.std.size, 0, []
    for data, e, Z in zip(plain.experiments, plain.residuals(at.e), at.spans, strict=True):
        outputs = []
        for i, std in enumerate(plain.std):
            known = data.valid[:, i]
            rows = slice(begin, begin + int(known.sum()))
            begin = rows.stop
            H = _spread(basis.Q[rows] / std, known)
            of_output = OutputResiduals(e=e[:, i], y=data.y[:, i], H=H)
            # The outputs share the free responses, so one output alone has no basis of them.
            if ny == 1:
                of_output = replace(of_output, Z=_spread(Z, known))
            else:
                of_output = replace(of_output, Psi=_spread(at.Psi[rows] * std, known))
            outputs.append(of_output)
        experiments.append(outputs)
    unknown = sum(x.size for x in at.free)
    each = None if ny == 1 else [(basis.W.shape[0] + unknown) / ny] * ny
    return infer(experiments, basis.W, score="exogenous", parameters=each)


def _spread(rows: Matrix, known: Mask) -> Matrix:
    """Return a matrix for all samples, with `rows` at the known samples and zeros elsewhere."""
    whole = np.zeros((known.size, rows.shape[1]))
    whole[known] = rows
    return whole


def determined(Psi: Matrix, names: Sequence[str]) -> Basis:
    """Return an orthonormal basis of the derivatives; refuse indistinguishable parameters."""
    basis = orthonormal(Psi)
    if basis.rank < Psi.shape[1]:
        _, _, Vt = np.linalg.svd(Psi / np.linalg.norm(Psi, axis=0), full_matrices=False)
        alike = [name for name, v in zip(names, Vt[-1], strict=True) if abs(v) > _MIN_COMPONENT]
        raise InputError(
            f"the data determine only {basis.rank} of {Psi.shape[1]} parameters and cannot "
            f"distinguish {' and '.join(alike)}: hold one of them fixed"
        )
    return basis


def no_model(fit: float) -> Iterator[str]:
    """Yield a warning if the model explains the output less well than a constant."""
    if fit < 0:
        yield (
            f"the fit is {fit:.1f} %, below 0: a constant explains the output better. Check the "
            "units and the calibration of the data, the model, and the fixed parameters"
        )


def noise_warnings(
    outputs: Sequence[str], steps: Sequence[float], found: Inference, *, has_friction: bool
) -> Iterator[str]:
    """Yield warnings of noise below a third of a converter step, and of coloured residuals."""
    variances = np.diag(found.noise_covariance).tolist()
    for name, step, variance, quality in zip(outputs, steps, variances, found.quality, strict=True):
        of_output = f"{name}: " if len(outputs) > 1 else ""
        if quiet := too_quiet(step, variance):
            yield f"{of_output}{quiet}"
        if quality.white.coloured:
            perhaps = "" if has_friction else " (friction?)"
            yield (
                f"{of_output}the residuals are {quality.white}: the model lacks a property of the "
                f"rig{perhaps}, or the noise is not white; prefer std_robust"
            )
