"""Model with several inputs and outputs, estimated from `Signals`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import ArrayLike

from armrig.data.finding import EstimateFinding
from armrig.data.signals import Signals
from armrig.models.estimate import Start
from armrig.models.fit import Fit
from armrig.models.model import Matrix, Vector, freeze
from armrig.models.multivariable.polynomials import Channel
from armrig.models.multivariable.state_space import StateSpace, predicted
from armrig.models.responses import FrequencyResponse, Roots, StepResponse
from armrig.numerics.inference import OutputQuality

if TYPE_CHECKING:
    from os import PathLike

    import control

    from armrig.models.multivariable.comparison import SignalsComparisonTable


class Form(Protocol):
    """Parameters of a model, with the polynomials and matrices that they define."""

    @property
    def theta(self) -> Vector:
        """Parameters (d,)."""

    def replaced(self, theta: Vector) -> Form:
        """Return the form with other parameters."""

    def channel(self, i: int, j: int) -> Channel:
        """Return the polynomials from input j to output i."""

    def has(self, i: int, j: int) -> bool:
        """Return whether input j affects output i."""

    def realised(self) -> StateSpace:
        """Return the innovations form."""

    @property
    def coupled(self) -> bool:
        """True if the channels have no noise polynomials of their own."""

    @property
    def integrators(self) -> tuple[bool, ...]:
        """True for each output that integrates by construction."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class MultivariableFit:
    """A model of several outputs and inputs with its uncertainty.

    `fit["alpha", "u"]` returns the model from u to alpha as a `Fit`, with its poles, responses,
    standard deviations, texts and figures.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().signals()
    >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
    >>> fit.outputs, fit.inputs
    (('theta_1', 'alpha'), ('u',))
    >>> [quality.white.coloured for quality in fit.quality]
    [False, False]
    >>> fit["alpha", "u"].poles().values.round(2)
    array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """

    structure: str
    """Name of the estimator, such as "oe"."""
    orders: str
    """Orders as text, such as "nb=2, nf=2, nk=1"."""
    form: Form
    """Parameters and equations."""
    inputs: tuple[str, ...]
    """Names of the inputs."""
    outputs: tuple[str, ...]
    """Names of the outputs."""
    input_units: tuple[str, ...]
    """Units of the inputs."""
    units: tuple[str, ...]
    """Units of the outputs."""
    Ts: float
    """Sampling time in s."""
    shared: bool = False
    """True if all outputs share one denominator."""
    output_weights: tuple[float, ...] = ()
    """Weights w_i if the estimator minimised the sum of w_i e_i²; empty if the weights were
    computed from the noise covariance."""
    covariance: Matrix
    """Covariance of theta (d, d), valid if the residuals are white."""
    covariance_robust: Matrix
    """Covariance of theta (d, d), sandwich form; also valid if the residuals are coloured."""
    noise_covariance: Matrix
    """Covariance Lambda of e (ny, ny)."""
    quality: tuple[OutputQuality, ...]
    """Loss, fit and whiteness of each output."""
    converged: bool = True
    """True if the search for the minimum converged within its tolerance."""
    starts: tuple[Start, ...] = ()
    """Start values with their results, best first; empty if no search was necessary."""
    findings: tuple[EstimateFinding, ...] = ()
    """Findings about the reliability of the numbers."""
    source: str = ""
    """Hash of the recording or data file, or ""."""
    history: tuple[str, ...] = ()
    """Steps of the treatment of the estimation data, in order."""
    digest: str = ""
    """Fingerprint of the estimation data."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, ("covariance", "covariance_robust", "noise_covariance"))

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def theta(self) -> Vector:
        """Parameters (d,), in the order that `form` defines."""
        return self.form.theta

    @property
    def std(self) -> Vector:
        """Standard deviations of theta (d,), from `covariance`."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def std_robust(self) -> Vector:
        """Standard deviations of theta (d,), from `covariance_robust`."""
        return np.sqrt(np.maximum(np.diag(self.covariance_robust), 0.0))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Text of each finding about the reliability of the numbers."""
        return tuple(f.text for f in self.findings)

    @property
    def label(self) -> str:
        """Name in tables and legends, such as "OE(nb=2, nf=2, nk=1)"."""
        return f"{self.structure.upper()}({self.orders})"

    def __getitem__(self, channel: tuple[str, str] | str) -> Fit:
        """Return the model from one input to one output: fit["alpha", "u"].

        The input may be left out if there is only one input.

        Raises
        ------
        ValueError
            There is no such output or input, or the input does not affect the output.
        """
        output, input = channel if isinstance(channel, tuple) else (channel, None)
        i = _index("output", output, self.outputs)
        j = _index("input", input, self.inputs)
        part = self.form.channel(i, j)
        quality = self.quality[i]
        return Fit(
            structure="channel" if self.form.coupled else self.structure,
            A=part.polynomials["A"],
            B=part.polynomials["B"],
            C=part.polynomials["C"],
            D=part.polynomials["D"],
            F=part.polynomials["F"],
            nk=part.nk,
            integrator=part.integrator,
            offset=part.integrator,
            Ts=self.Ts,
            output=self.outputs[i],
            unit=self.units[i],
            input_unit=self.input_units[j],
            covariance=part.J @ self.covariance @ part.J.T,
            covariance_robust=part.J @ self.covariance_robust @ part.J.T,
            noise_variance=float(self.noise_covariance[i, i]),
            loss=quality.loss,
            N=quality.N,
            fit_percent=quality.fit_percent,
            whiteness=quality.white.p_value,
            whiteness_test=quality.white.test,
            converged=self.converged,
            findings=self.findings,
            source=self.source,
            history=self.history,
        )

    def channels(self) -> Iterator[tuple[int, int, Fit]]:
        """Iterate over the channels that have a model: indices of output and input, and the model.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> for i, j, channel in fit.channels():
        ...     print(f"{fit.inputs[j]} to {fit.outputs[i]}: {channel.label}")
        u to theta_1: OE[4 4 1]
        u to alpha: OE[3 3 1]
        """
        for i, output in enumerate(self.outputs):
            for j, input in enumerate(self.inputs):
                if self.form.has(i, j):
                    yield i, j, self[output, input]

    def poles(self) -> Roots:
        """Return the poles of all denominators, output after output; equal denominators count once.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> fit.poles().values.round(2)
        array([1.  +0.j  , 0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
        """
        found: list[Fit] = []
        for _, _, fit in self.channels():
            if not any(np.array_equal(fit.denominator, known.denominator) for known in found):
                found.append(fit)
        if self.shared or self.form.coupled:
            found = [max(found, key=lambda fit: fit.denominator.size)]
        roots = [fit.poles() for fit in found]
        return Roots(
            values=np.concatenate([r.values for r in roots]),
            covariance=np.concatenate([r.covariance for r in roots]),
        )

    def frequency_response(self, omega: ArrayLike) -> FrequencyResponse:
        """Return G (n, ny, nu) at omega (n,) in rad/s, with standard deviations.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> response = fit.frequency_response([2, 18, 160])
        >>> response.G.shape
        (3, 2, 1)
        >>> abs(response.G[:, 1, 0]).round(3)  # from u to alpha
        array([0.015, 0.148, 0.003])
        """
        omega_ = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        G = np.zeros((omega_.size, self.ny, self.nu), dtype=np.complex128)
        magnitude, phase = np.zeros((2, *G.shape))
        for i, j, fit in self.channels():
            own = fit.frequency_response(omega_)
            G[:, i, j], magnitude[:, i, j], phase[:, i, j] = own.G, own.std_magnitude, own.std_phase
        return FrequencyResponse(omega=omega_, G=G, std_magnitude=magnitude, std_phase=phase)

    def step_response(self, n: int, *, rate: bool = False) -> StepResponse:
        """Return the first n samples (n, ny, nu) of the responses to a unit step of each input.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> response = fit.step_response(100, rate=True)
        >>> print(f"theta_1: {response.y[-1, 0, 0]:.2f} rad/s per V")
        theta_1: 1.86 rad/s per V
        """
        y, std = np.zeros((2, n, self.ny, self.nu))
        t: Vector = self.Ts * (np.arange(n, dtype=np.float64) + 0.5 * rate)
        for i, j, fit in self.channels():
            own = fit.step_response(n, rate=rate)
            y[:, i, j], std[:, i, j] = own.y, own.std
        return StepResponse(t=t, y=y, std=std, rate=rate)

    def simulate(self, u: ArrayLike) -> Matrix:
        """Return the outputs (N, ny) for the inputs u (N, nu), from rest and without noise.

        Raises
        ------
        ValueError
            u is not (N, nu).

        Examples
        --------
        >>> import armrig, numpy as np
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> y = fit.simulate(4.0 * np.ones((200, 1)))
        >>> y.shape
        (200, 2)
        >>> abs(y).max(axis=0).round(1)
        array([14.3,  0.3])
        """
        u_ = np.asarray(u, dtype=np.float64)
        u_ = u_[:, None] if u_.ndim == 1 else u_
        if u_.ndim != 2 or u_.shape[1] != self.nu:
            raise InputError(
                f"u has shape {np.shape(u)}; give (N, {self.nu}), a column for each of "
                f"{', '.join(self.inputs)}"
            )
        return self.form.realised().deterministic.simulated(u_)

    def predict(self, data: Signals, horizon: int | None = 1) -> Matrix:
        """Return ŷ(t) (N, ny) from u up to t and y up to t - horizon; horizon None uses u alone.

        The initial state of each experiment is estimated from the data by least squares. The input
        offset is estimated too if an output integrates: it causes a ramp of this output. If a
        sample of an output is missing, the prediction continues without the sample. The prediction
        of an output is NaN before the first measured sample of this output.

        Raises
        ------
        ValueError
            The data have other channels or another sampling time than the model.

        Examples
        --------
        >>> import armrig, numpy as np
        >>> first, second = armrig.example_recording().signals().split(2)
        >>> fit = armrig.oe(first, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> error = second.y - fit.predict(second)
        >>> np.sqrt(np.nanmean(error**2, axis=0)).round(3)
        array([0.004, 0.004])
        """
        require_same_channels(self, data)
        if horizon is not None and (isinstance(horizon, bool) or int(horizon) < 1):
            raise InputError(f"horizon={horizon!r} must be an integer >= 1, or None for simulation")
        system = self.form.realised()
        return np.concatenate(
            [
                predicted(
                    system,
                    part,
                    horizon=horizon,
                    integrating=self.form.integrators,
                    noise_std=np.sqrt(np.diag(self.noise_covariance)),
                )
                for part in data.experiments()
            ]
        )

    def state_space(self) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """Return A, B, C, D and K of the innovations form.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> A, B, C, D, K = fit.state_space()
        >>> B.shape[1], C.shape[0], K.shape[1]
        (1, 2, 2)
        >>> bool(K.any())  # an output-error model has no K
        False
        """
        s = self.form.realised()
        return s.A, s.B, s.C, s.D, s.K

    def to_control(self) -> control.StateSpace:
        """Return the model from u to y as a python-control system with named signals, dt=Ts.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> system = fit.to_control()
        >>> system.input_labels, system.output_labels, system.dt
        (['u'], ['theta_1', 'alpha'], 0.01)
        """
        import control

        s = self.form.realised().deterministic
        return control.ss(
            s.A, s.B, s.C, s.D, self.Ts, inputs=list(self.inputs), outputs=list(self.outputs)
        )

    def compare(
        self, data: Signals, *others: MultivariableFit, horizon: int | None = None
    ) -> SignalsComparisonTable:
        """Compare this model and the models `others` with data: see `armrig.compare`.

        Examples
        --------
        >>> import armrig
        >>> first, second = armrig.example_recording().signals().split(2)
        >>> fit = armrig.oe(first, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> print(fit.compare(second))
        simulation; initial state estimated from these data by least squares
          OE(nb=[[4],[3]], nf=3, nk=1)
            theta_1  fit   99.98 %  rms 0.0035... rad
            alpha    fit   97.5... %  rms 0.0035... rad
        """
        from armrig.models.multivariable.comparison import compare

        return compare(data, self, *others, horizon=horizon)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model as JSON, with all digits of each number; `armrig.load_fit` reads it.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().signals()
        >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> fit.save("both.json")
        >>> armrig.load_fit("both.json").outputs
        ('theta_1', 'alpha')
        """
        from armrig.models.multivariable.model_writing import save_fit

        save_fit(self, path)

    def _repr_html_(self) -> str:
        """Return the model as HTML for a notebook."""
        from html import escape

        return f"<pre>{escape(repr(self))}</pre>"

    def estimated_from(self, data: Signals) -> bool:
        """Return whether the model was estimated from these data.

        Examples
        --------
        >>> import armrig
        >>> first, second = armrig.example_recording().signals().split(2)
        >>> fit = armrig.oe(first, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
        >>> fit.estimated_from(first), fit.estimated_from(second)
        (True, False)
        """
        return bool(self.digest) and self.digest == data.digest

    def __repr__(self) -> str:
        """Return the model as text: a line with the fit of each output, and the poles."""
        from armrig.models.multivariable.text import described

        return described(self)


def require_same_channels(fit: MultivariableFit, data: Any) -> None:
    """Refuse data whose channels, units or sampling time differ from the model."""
    if not isinstance(data, Signals):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give Signals with {', '.join(fit.outputs)} and "
            f"{', '.join(fit.inputs)}; for inputs alone, use fit.simulate(u)"
        )
    if not np.isclose(fit.Ts, data.equidistant(), rtol=1e-9, atol=0.0):
        raise InputError(
            f"the model has Ts={fit.Ts:g} s and the data have Ts={data.Ts:g} s; identify and "
            "validate at the same rate"
        )
    for what, own, theirs in (
        ("outputs", fit.outputs, data.outputs),
        ("inputs", fit.inputs, data.inputs),
    ):
        if own != theirs:
            raise InputError(
                f"the model's {what} are {', '.join(own)} and the data have {', '.join(theirs)}; "
                "choose them with signals.channels(outputs, inputs)"
            )


def _index(what: str, name: str | None, names: tuple[str, ...]) -> int:
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        said = f"{what} {name!r}: there is no such {what}" if name else f"which {what}?"
        raise InputError(f"{said}; the model has {', '.join(names)}")
    return names.index(name)
