"""Models and frequency responses made by hand, of one and of several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from armrig.models.fit import Fit
from armrig.models.matrices import Matrices
from armrig.models.polynomials import Polynomials
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.inference import OutputQuality
from armrig.numerics.whiteness import Whiteness
from numpy.typing import NDArray


def made(
    *,
    A: Sequence[float] = (1.0,),
    B: Sequence[float] = (0.0, 1.0),
    C: Sequence[float] = (1.0,),
    D: Sequence[float] = (1.0,),
    F: Sequence[float] = (1.0,),
    nk: int = 1,
    std: Sequence[float] = (),
    **fields: Any,
) -> Fit:
    """Return a fit with these polynomials; the robust deviations are twice the ordinary ones."""
    d = len(A) + len(B) + len(C) + len(D) + len(F) - 4 - nk
    covariance = np.diag(np.square(std)) if len(std) else np.zeros((d, d))
    values: dict[str, Any] = _QUALITY | {
        "structure": "pem",
        "covariance": covariance,
        "covariance_robust": 4 * covariance,
        "Ts": 0.1,
        "output": "alpha",
        "unit": "rad",
        "input_unit": "V",
    }
    polynomials = {"A": A, "B": B, "C": C, "D": D, "F": F}
    arrays = {letter: np.array(p, dtype=float) for letter, p in polynomials.items()}
    return _of_channel(values | arrays | {"nk": nk} | fields)


_QUALITY: dict[str, Any] = {"noise_variance": 0.04, "loss": 0.03, "N": 100, "fit_percent": 91.234}
_QUALITY |= {"whiteness": 0.5, "whiteness_test": "portmanteau test"}


def _of_channel(values: dict[str, Any]) -> Fit:
    """Return a model; the names of its quality are those of the properties of `Fit`."""
    given = {name: values.pop(name) for name in _QUALITY if name in values}
    if given:
        white = Whiteness(p_value=given.pop("whiteness"), test=given.pop("whiteness_test"))
        values["noise_covariance"] = np.array([[given.pop("noise_variance")]])
        values["quality"] = (OutputQuality(**given, white=white),)
    return Fit.of_channel(**values)


def changed(fit: Fit, **fields: Any) -> Fit:
    """Return a model of one output and input with other polynomials, quality or other fields."""
    names = ("A", "B", "C", "D", "F", "nk", "integrator", "output", "unit", "input_unit")
    if fit.quality:
        names += tuple(_QUALITY)
    known = {name: getattr(fit, name) for name in names}
    left_out = {"form", "quality", "noise_covariance", "inputs", "outputs", "input_units", "units"}
    if not fit.quality:
        left_out |= {"covariance", "covariance_robust"}
    known |= {f.name: getattr(fit, f.name) for f in dataclass_fields(Fit) if f.name not in left_out}
    return _of_channel(known | fields)


def made_estimate(omega: NDArray[np.float64], G: Any, **fields: Any) -> SpectralEstimate:
    """Return an estimate by hand, without deviations unless given."""
    unknown = np.full(omega.size, np.nan)
    values: dict[str, Any] = {
        "std_magnitude": unknown,
        "std_phase": unknown,
        "method": "by hand, Hann",
        "integrator": False,
        "N": 60,
        "Ts": 0.1,
        "output": "theta_1",
        "unit": "rad",
        "input_unit": "V",
        "source": "",
    }
    return SpectralEstimate(omega=omega, G=np.asarray(G, complex), **(values | fields))


ONE = np.ones(1)


def vectors(*rows: Any) -> Any:
    return tuple(tuple(np.array(p, float) for p in row) for row in rows)


def apart(integrators: tuple[bool, bool] = (False, False)) -> Polynomials:
    """Return Box-Jenkins rows: three inputs, of which v does not reach b."""
    F = vectors([(1, -0.5), (1, -0.6, 0.2), (1, -0.3)], [(1, -0.8), (1,), (1, 0.1, -0.3)])
    if integrators[0]:
        F = (tuple(np.convolve([1, -1], f) for f in F[0]), F[1])
    return Polynomials(
        A=vectors([ONE, (0,)], [(0,), ONE]),
        B=vectors([(0, 1, 0.5), (0.7,), (0, 0, 0, 2)], [(0, 0, 0.3), (0,), (0, -1, 0.2)]),
        C=(np.array([1, 0.4]), ONE),
        D=(np.array([1, -0.7, 0.1]), np.array([1, 0.3])),
        F=F,
        nk=((1, 0, 3), (2, 1, 1)),
        integrators=integrators,
    )


def joined() -> Polynomials:
    """Return ARX rows whose outputs affect each other; w reaches a by b alone."""
    return Polynomials(
        A=vectors([(1, -0.8, 0.2), (0, 0.3)], [(0, -0.2, 0.1), (1, -0.5)]),
        B=vectors([(0, 1, 0.5), (0, 0, 0.7), (0, 0)], [(0, 0, 0.3), (0.4,), (0, 0, 0, 1)]),
        C=(ONE, ONE),
        D=(ONE, ONE),
        F=vectors([ONE] * 3, [ONE] * 3),
        nk=((1, 2, 2), (2, 0, 3)),
        integrators=(False, False),
    )


def matrices() -> Matrices:
    """Return three states, three inputs with delays of their own, two outputs."""
    rng = np.random.default_rng(1)
    A = np.diag([0.8, 0.5, -0.4]) + 0.1 * rng.standard_normal((3, 3))
    B, C = rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
    D = np.array([[0.0, 0.3, 0.0], [0.0, -0.2, 0.0]])
    return Matrices(A=A, B=B, C=C, D=D, K=0.2 * rng.standard_normal((3, 2)), nk=(1, 0, 3))


def of_one_output(nu: int, *, noise: bool = True, nk: int = 1) -> Matrices:
    """Return two states and one output; the first input has the delay nk."""
    rng = np.random.default_rng(2)
    return Matrices(
        A=np.array([[0.8, 0.2], [-0.1, 0.5]]),
        B=rng.standard_normal((2, nu)),
        C=rng.standard_normal((1, 2)),
        D=0.5 * np.eye(1, nu) * (nk == 0),
        K=0.3 * noise * rng.standard_normal((2, 1)),
        nk=(nk, *[1] * (nu - 1)),
    )


def fit_of_form(form: Any, **fields: Any) -> Fit:
    """Return a model with the inputs u, v, w and the outputs a, b."""
    d = form.theta.size
    P = np.diag(np.square(0.001 * np.arange(1, d + 1)))
    values: dict[str, Any] = {
        "structure": "bj",
        "specification": "nb=2, nf=2, nk=1",
        "form": form,
        "inputs": ("u", "v", "w"),
        "outputs": ("a", "b"),
        "input_units": ("V", "A", ""),
        "units": ("rad", "m"),
        "Ts": 0.1,
        "covariance": P,
        "covariance_robust": 4 * P,
        "noise_covariance": np.array([[0.04, -0.03], [-0.03, 0.09]]),
        "quality": (
            OutputQuality(
                loss=0.05, N=90, fit_percent=80.5, white=Whiteness(p_value=0.5, test="portmanteau")
            ),
            OutputQuality(
                loss=0.1, N=95, fit_percent=-3.25, white=Whiteness(p_value=1e-4, test="Ljung-Box")
            ),
        ),
    }
    return Fit(**(values | fields))


def with_all_polynomials() -> Polynomials:
    """Return the rows of `apart` with an A of each output's own."""
    return replace(apart(), A=vectors([(1, -0.4), (0,)], [(0,), (1, 0.2, 0.1)]))


FORMS: dict[str, Any] = {"apart": apart, "joined": joined, "matrices": matrices}
MORE = FORMS | {"A of each output": with_all_polynomials}
OF_ONE_OUTPUT: dict[str, Any] = {
    "2 inputs": lambda: of_one_output(2),
    "1 input": lambda: of_one_output(1),
    "direct": lambda: of_one_output(1, nk=0),
    "delayed": lambda: of_one_output(1, nk=3),
    "without K": lambda: of_one_output(2, noise=False),
    **{
        f"ARMAX, nk {nk}": partial(
            Polynomials.of_channel, A=(1, -1.2, 0.5), B=B, C=(1, 0.4, 0.1), nk=nk
        )
        for nk, B in enumerate([(0.3, 1.0, 0.5), (0, 1.0, 0.5), (0, 0, 0.7), (0, 0, 0, 0.7)])
    },
}
