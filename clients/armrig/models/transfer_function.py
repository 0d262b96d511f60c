"""Transfer function B(s)/F(s) exp(-delay s) of one input and one output, and its exact sampling.

The noise is sampled: y(t) = B(s)/F(s) u(t - delay) + C(q)/D(q) e(t). C and D are valid at the
sampling time of the estimation data.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armrig.models.polynomials import Polynomials
from armrig.models.state_space import Matrix, StateSpace, Vector, freeze
from armrig.numerics.exact_sampling import Hold, sample_system

_ONE = np.ones(1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferFunction:
    """Coefficients in s, highest power first, and the noise at one sampling time.

    The fields A to integrators are those of `Polynomials`, so that both have the same readers.
    """

    B: tuple[tuple[Vector, ...], ...]
    """Numerator b_0 s^m + … + b_m."""
    F: tuple[tuple[Vector, ...], ...]
    """Denominator s^n + f_1 s^(n-1) + … + f_n, beginning with 1; n > m."""
    C: tuple[Vector, ...] = (_ONE,)
    """Coefficients in q^-1, beginning with 1."""
    D: tuple[Vector, ...] = (_ONE,)
    """Coefficients in q^-1, beginning with 1."""
    delay: float = 0.0
    """Time from u to y, in s."""
    delay_estimated: bool = False
    """True if the delay is a parameter."""
    integrators: tuple[bool, ...] = (False,)
    """True if F has the factor s by construction: f_n is 0."""
    Ts: float
    """Sampling time of the estimation data, in s."""
    hold: Hold = "zoh"
    """Course of u between the samples of the estimation data: held, or a straight line."""
    A: tuple[tuple[Vector, ...], ...] = ((_ONE,),)
    """Always 1."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, ("A", "B", "C", "D", "F"))

    @property
    def nk(self) -> tuple[tuple[int, ...], ...]:
        """Number of zeros before the coefficients of B: none."""
        return ((0,),)

    @property
    def theta(self) -> Vector:
        """Parameters b, c, d, f, and the delay if it was estimated."""
        return np.concatenate([p for *_, p in self._parts()])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: b0 …, c1 …, d1 …, f1 …, delay."""
        return tuple(
            f"{letter}{first + k}" if letter != "delay" else letter
            for letter, first, p in self._parts()
            for k in range(p.size)
        )

    def _parts(self) -> Iterator[tuple[str, int, Vector]]:
        """Yield name, first index and values of each group of parameters."""
        yield "b", 0, self.B[0][0]
        yield "c", 1, self.C[0][1:]
        yield "d", 1, self.D[0][1:]
        yield "f", 1, self.F[0][0][1:]
        if self.delay_estimated:
            yield "delay", 0, np.array([self.delay])

    def slice_of(self, letter: str, i: int = 0, k: int = 0) -> slice:
        """Return the slice of theta with the parameters of one polynomial, or with the delay."""
        begin = 0
        for name, _, p in self._parts():
            if name == letter:
                return slice(begin, begin + p.size)
            begin += p.size
        return slice(begin, begin) if letter == "delay" else slice(0, 0)

    def replaced(self, theta: Vector) -> TransferFunction:
        """Return the transfer function with other parameters."""
        p = {letter: theta[self.slice_of(letter)] for letter in ("b", "c", "d", "f", "delay")}
        return replace(
            self,
            B=((p["b"],),),
            F=((np.append(1.0, p["f"]),),),
            C=(np.append(1.0, p["c"]),),
            D=(np.append(1.0, p["d"]),),
            delay=float(p["delay"][0]) if self.delay_estimated else self.delay,
        )

    @property
    def coupled(self) -> bool:
        """False: there is one output."""
        return False

    def has(self, i: int, j: int) -> bool:
        """Return True: the input affects the output."""
        return True

    def channel(self, i: int, j: int) -> tuple[TransferFunction, Matrix]:
        """Return this transfer function, and the derivatives of its parameters by themselves."""
        return self, np.eye(self.theta.size)

    def sampled(self, Ts: float) -> tuple[Polynomials, Matrix]:
        """Return the polynomials in q^-1 at the sampling time Ts, and their derivatives by theta.

        The noise C/D is that of the estimation data. At another sampling time it is not known, and
        C and D are 1.
        """
        b, F = self.B[0][0], self.F[0][0]
        powers = Ts ** np.arange(1.0, F.size)
        scale = Ts ** (F.size - 1 - np.arange(b.size - 1.0, -1.0, -1.0))
        exact = sample_system(
            F[1:] * powers, self.delay / Ts, self.hold, fraction=self.delay_estimated
        )
        M = exact.B[:, b.size - 1 :: -1] * scale  # columns in the order b_0 … b_m
        B, F_q = M @ b, exact.F
        same = bool(np.isclose(Ts, self.Ts, rtol=1e-9, atol=0.0))
        C, D = (self.C[0], self.D[0]) if same else (_ONE, _ONE)
        if self.integrators[0]:
            free = np.cumsum(F_q)[:-1]
            F_q = np.convolve(free, [1.0, -1.0])
        form = Polynomials.of_channel(
            B=np.append(np.zeros(exact.nk), B),
            C=C,
            D=D,
            F=F_q,
            nk=exact.nk,
            integrator=self.integrators[0],
        )
        J = np.zeros((form.theta.size, self.theta.size))
        columns = {letter: self.slice_of(letter) for letter in ("b", "c", "d", "f", "delay")}
        rows = {letter: form.slice_of(letter, 0, 0) for letter in "bcdf"}
        J[rows["b"], columns["b"]] = M
        at, used = b * scale, slice(b.size - 1, None, -1)
        J[rows["b"], columns["f"]] = np.einsum("lpk,p->lk", exact.B_by_f[:, used], at) * powers
        J[rows["f"], columns["f"]] = exact.F_by_f[1:] * powers
        if self.integrators[0]:  # f_n is fixed
            J[:, columns["f"].stop - 1] = 0.0
        if self.delay_estimated:
            J[rows["b"], columns["delay"]] = (exact.B_by_delay[:, used] @ at / Ts)[:, None]
        if same:
            for letter in "cd":
                J[rows[letter], columns[letter]] = np.eye(rows[letter].stop - rows[letter].start)
        return form, J

    def innovations_form(self) -> StateSpace:
        """Return the innovations form, sampled as the estimation data."""
        return self.sampled(self.Ts)[0].innovations_form()
