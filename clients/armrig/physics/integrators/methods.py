"""The integration methods as data: coefficients, orders and stability polynomials.

A method applied to x' = lambda x with the step h is a linear recursion. Its solutions are zeta^n,
with zeta a root of the stability polynomial pi(zeta; z) at z = h lambda::

    linear multistep   sum alpha_j x(n+j) = h sum beta_j f(n+j):  pi = rho(zeta) - z sigma(zeta)
    Runge-Kutta        x(n+1) = R(z) x(n):                        pi = zeta - R(z)

The method is absolutely stable at z if no root is outside the unit circle and roots on the circle
are simple.

References
----------
.. [1] E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 1993,
   sections II.1 and III.1-III.2.
.. [2] E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II*, 1996, sections IV.2, V.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from armrig_core.errors import InputError

from armrig.numerics.polynomial import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Multistep:
    """A linear multistep method, sum alpha_j x(n+j) = h sum beta_j f(n+j), j = 0 … k."""

    name: str
    """Name in texts and figures."""
    alpha: tuple[float, ...]
    """Coefficients of rho; the last one is alpha_k = 1."""
    beta: tuple[float, ...]
    """Coefficients of sigma; the method is implicit if the last one is not 0."""
    order: int
    """Order p: the global error falls as h^p."""
    start: str = ""
    """Method of the first k - 1 steps, "" for k = 1."""
    work: int
    """Number of products with A and of solved systems with I - beta_k h A, per step."""

    @property
    def stability_polynomial(self) -> Array:
        """Coefficients of pi, (k + 1, 2): entry j, i belongs to zeta^j z^i."""
        return np.column_stack([self.alpha, -np.array(self.beta)])


@dataclass(frozen=True, slots=True, kw_only=True)
class RungeKutta:
    """An explicit Runge-Kutta method.

    K_i = f(t + c_i h, x + h sum a_ij K_j), and x(n+1) = x(n) + h sum b_i K_i.
    """

    name: str
    """Name in texts and figures."""
    a: tuple[tuple[float, ...], ...]
    """Tableau, strictly lower triangular."""
    b: tuple[float, ...]
    """Weights of the stages."""
    c: tuple[float, ...]
    """Times of the stages as shares of the step, 0 to 1."""
    order: int
    """Order p: the global error falls as h^p."""

    @property
    def work(self) -> int:
        """Number of products with A per step, one for each stage."""
        return len(self.b)

    @property
    def stability_polynomial(self) -> Array:
        """Coefficients of pi = zeta - R(z), R(z) = 1 + sum z^(i+1) b^T a^i 1, (2, stages + 1)."""
        a, v = np.array(self.a), np.ones(len(self.b))
        R = [1.0]
        for _ in self.b:
            R.append(float(np.dot(self.b, v)))
            v = a @ v
        unit = np.zeros(len(R))
        unit[0] = 1.0
        return np.stack([-np.array(R), unit])


Method = Multistep | RungeKutta

METHODS: MappingProxyType[str, Method] = MappingProxyType(
    {
        "forward_euler": Multistep(
            name="forward Euler", alpha=(-1.0, 1.0), beta=(1.0, 0.0), order=1, work=1
        ),
        "ab2": Multistep(
            name="AB(2)",
            alpha=(0.0, -1.0, 1.0),
            beta=(-0.5, 1.5, 0.0),
            order=2,
            start="heun",
            work=1,
        ),
        "trapezoidal": Multistep(
            name="trapezoidal rule", alpha=(-1.0, 1.0), beta=(0.5, 0.5), order=2, work=2
        ),
        "heun": RungeKutta(
            name="Heun, RK(2)", a=((0.0, 0.0), (1.0, 0.0)), b=(0.5, 0.5), c=(0.0, 1.0), order=2
        ),
        "midpoint": RungeKutta(
            name="midpoint, RK(2)", a=((0.0, 0.0), (0.5, 0.0)), b=(0.0, 1.0), c=(0.0, 0.5), order=2
        ),
    }
)
"""The handout's methods (4.1-4.4) by their names for `integrate`."""


def method_named(name: str) -> Method:
    """Return the method with this name.

    Raises ValueError if there is no method with this name.
    """
    if name not in METHODS:
        raise InputError(f"method={name!r} is none of {', '.join(METHODS)}")
    return METHODS[name]


def amplification(method: Method, z: Array) -> Array:
    """Return the largest root |zeta| for each element of z: the growth of an error per step."""
    p = method.stability_polynomial
    at_z = np.stack([np.polyval(row[::-1], z) for row in p], axis=-1)
    if at_z.shape[-1] == 2:
        return np.asarray(np.abs(at_z[..., 0] / at_z[..., 1]))
    k = at_z.shape[-1] - 1
    companion = np.zeros((*np.shape(z), k, k), dtype=np.complex128)
    companion[..., :-1, 1:] = np.eye(k - 1)
    companion[..., -1, :] = -at_z[..., :-1] / at_z[..., -1:]
    return np.asarray(np.abs(np.linalg.eigvals(companion)).max(axis=-1))
