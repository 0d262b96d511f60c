"""Model of any number of signals, with its uncertainty, predictions, texts and figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.columns import index_of
from armrig.models.continuous_time import Quantities, continuous, discrete, quantities
from armrig.models.estimate import Estimate, Minimisation
from armrig.models.polynomials import Polynomials
from armrig.models.responses import (
    FrequencyResponse,
    NoiseSpectrum,
    Roots,
    StepResponse,
    frequencies,
    polynomial_roots,
    ratio,
    sensitivity,
    standard_deviations,
)
from armrig.models.state_space import Matrix, Vector
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.checks import column, require_integers
from armrig.numerics.polynomial import apply_filter

if TYPE_CHECKING:
    from os import PathLike

    import control
    from matplotlib.figure import Figure

    from armrig.data.dataset import Dataset, Signals
    from armrig.models.summary import Summary

_ONE = np.ones(1)


# Not slotted: an assignment to a property of a frozen class with slots raises a TypeError.
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Fit(Estimate):
    """A model A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) or a state space, with its uncertainty.

    A model of one input and one output has the polynomials A, B, C, D and F. The model of several
    signals has a channel for each input and output: `fit["y", "u"]` is the model from u to y,
    with its poles, responses, standard deviations, texts and figures.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> fit = armrig.oe(data, nb=4, nf=4, integrator=True)
    >>> print(fit)
    OE(nb=4, nf=4, nk=1): u [V] to theta_1 [rad], Ts 0.01 s, N 2903
      y(t) = B(q)/F(q) u(t) + e(t)
      ...
      F has the factor 1 - q^-1 by construction
      fit 99.99 % one step ahead on estimation data, loss 1.25...e-05, ...
      residuals white (p = 0.6..., portmanteau test): trust std
      ...
    >>> fit.poles().values.round(2)
    array([1.  +0.j  , 0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])

    A model of two outputs that share a denominator:

    >>> data = armrig.example_recording().signals()
    >>> fit = armrig.oe(data, nb=[[4], [3]], nf=3, integrator="theta_1", shared="denominator")
    >>> fit.outputs, fit.inputs
    (('theta_1', 'alpha'), ('u',))
    >>> [quality.white.coloured for quality in fit.quality]
    [False, False]
    >>> fit["alpha", "u"].poles().values.round(2)
    array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """

    @classmethod
    def of_channel(
        cls,
        *,
        structure: str = "model",
        A: ArrayLike = _ONE,
        B: ArrayLike,
        C: ArrayLike = _ONE,
        D: ArrayLike = _ONE,
        F: ArrayLike = _ONE,
        nk: int,
        integrator: bool = False,
        input: str = "u",
        output: str = "y",
        input_unit: str = "",
        unit: str = "",
        **fields: Any,
    ) -> Fit:
        """Return a model of one input and one output from its polynomials.

        Parameters
        ----------
        A, B, C, D, F : array_like
            Coefficients in q^-1; B begins with nk zeros, the others with 1.
        **fields
            Other fields of `Fit`, such as Ts, covariance, quality and history. The default of the
            covariances is 0, for a model that was not estimated.

        Examples
        --------
        >>> armrig.Fit.of_channel(B=[0, 1], F=[1, -0.5], nk=1, Ts=0.1).poles().values
        array([0.5+0.j])
        """
        form = Polynomials.of_channel(A=A, B=B, C=C, D=D, F=F, nk=nk, integrator=integrator)
        unknown = np.zeros((form.theta.size,) * 2)
        covariances = {"covariance": unknown, "covariance_robust": unknown}
        return cls(
            structure=structure,
            form=form,
            inputs=(input,),
            outputs=(output,),
            input_units=(input_unit,),
            units=(unit,),
            **covariances | {"noise_covariance": np.zeros((1, 1))} | fields,
        )

    def __getitem__(self, channel: tuple[str, str] | str) -> Fit:
        """Return the model from one input to one output: fit["alpha", "u"].

        The input may be left out if there is only one input.

        Raises
        ------
        ValueError
            There is no such output or input, or the input does not affect the output.
        """
        output, input = channel if isinstance(channel, tuple) else (channel, None)
        i = index_of("output", output, self.outputs)
        j = index_of("input", input, self.inputs)
        if self.ny == self.nu == 1:
            return self
        form, J = self.form.channel(i, j)
        return Fit(
            structure="channel" if self.form.coupled else self.structure,
            form=form,
            inputs=(self.inputs[j],),
            outputs=(self.outputs[i],),
            input_units=(self.input_units[j],),
            units=(self.units[i],),
            Ts=self.Ts,
            offset=self.offset or form.integrators[0],
            covariance=J @ self.covariance @ J.T,
            covariance_robust=J @ self.covariance_robust @ J.T,
            noise_covariance=self.noise_covariance[i : i + 1, i : i + 1],
            quality=self.quality[i : i + 1],
            search=Minimisation(converged=self.search.converged),
            findings=self.findings,
            source=self.source,
            history=self.history,
        )

    def channels(self) -> Iterator[tuple[int, int, Fit]]:
        """Iterate over the channels that have a model: indices of output and input, and the model.

        Examples
        --------
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
        """Return the poles from the inputs to the outputs: the roots of A, then the roots of F.

        The poles of several outputs follow one another; equal denominators count once.

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.poles().values.round(2)
        array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
        >>> fit.poles().std.round(4)
        array([0.0002, 0.0002, 0.0015])
        """
        if self.ny == self.nu == 1:
            root_groups = [polynomial_roots(self, letter) for letter in "af"]
        else:
            distinct: dict[bytes, Fit] = {}
            for _, _, fit in self.channels():
                distinct.setdefault(fit.denominator.tobytes(), fit)
            fits = [*distinct.values()]
            if self.shared or self.form.coupled:
                fits = [max(fits, key=lambda fit: fit.denominator.size)]
            root_groups = [fit.poles() for fit in fits]
        return Roots(
            values=np.concatenate([r.values for r in root_groups]),
            covariance=np.concatenate([r.covariance for r in root_groups]),
        )

    def zeros(self) -> Roots:
        """Return the zeros from u to y, without the zeros at 0 and at infinity that delays cause.

        Examples
        --------
        The zero at 1 means that the output is 0 at a constant voltage.

        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.zeros().values.round(2)
        array([ 1.  +0.j, -0.92+0.j])
        """
        return polynomial_roots(self, "b")

    def frequency_response(self, omega: ArrayLike) -> FrequencyResponse:
        """Return G at omega (n,) in rad/s, for a sampled model up to the Nyquist frequency pi/Ts.

        G is (n,) for one input and one output, otherwise (n, ny, nu). The relative error of |G| is
        the real part of d ln G = dG/G. The error of the phase is the imaginary part of d ln G.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.

        Examples
        --------
        The arm resonates near 18 rad/s.

        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> response = fit.frequency_response([2, 18, 160])
        >>> abs(response.G).round(3)
        array([0.015, 0.148, 0.003])
        """
        omega_ = frequencies(self, omega)
        if (self.ny, self.nu) != (1, 1):
            G = np.zeros((omega_.size, self.ny, self.nu), dtype=np.complex128)
            magnitude, phase = np.zeros((2, *G.shape))
            for i, j, fit in self.channels():
                response = fit.frequency_response(omega_)
                G[:, i, j] = response.G
                magnitude[:, i, j], phase[:, i, j] = response.std_magnitude, response.std_phase
            return FrequencyResponse(omega=omega_, G=G, std_magnitude=magnitude, std_phase=phase)
        G, dlnG = ratio(self, omega_, "b", "af")
        with np.errstate(invalid="ignore"):
            relative, phase = (
                standard_deviations(d, self.trusted_covariance) for d in (dlnG.real, dlnG.imag)
            )
            magnitude = np.abs(G) * relative
        return FrequencyResponse(omega=omega_, G=G, std_magnitude=magnitude, std_phase=phase)

    def noise_spectrum(self, omega: ArrayLike) -> NoiseSpectrum:
        """Return the power spectrum of C/(A D) e at omega (n,) in rad/s, up to pi/Ts.

        Phi is lambda Ts |C/(A D)|². The variance of the noise is the integral of Phi/(2 pi) from
        -pi/Ts to pi/Ts. The standard deviation of Phi includes the uncertainty of lambda, whose
        variance is 2 lambda²/N.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.

        Examples
        --------
        The noise of an output-error model is white.

        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> spectrum = fit.noise_spectrum([1, 10, 100])
        >>> (spectrum.Phi / (fit.noise_variance * fit.Ts)).round(3)
        array([1., 1., 1.])
        """
        if self.Ts == 0:
            return self.to_discrete().noise_spectrum(omega)
        omega_ = frequencies(self, omega)
        H, dlnH = ratio(self, omega_, "c", "ad")
        Phi = self.noise_variance * self.Ts * np.abs(H) ** 2
        with np.errstate(invalid="ignore"):
            relative = np.hypot(
                2 * standard_deviations(dlnH.real, self.trusted_covariance), np.sqrt(2 / self.N)
            )
            std = Phi * relative
        return NoiseSpectrum(omega=omega_, Phi=Phi, std=std)

    def step_response(self, n: int, *, rate: bool = False) -> StepResponse:
        """Return the first n samples, n >= 1, of the response to a unit step from rest.

        The response is (n,) for one input and one output. For several signals it is (n, ny, nu),
        with the responses to a step of each input.

        If `rate` is True, the response is the rate (y(t) - y(t-1))/Ts, at the middle of each
        sampling interval. Use `rate` for an integrating output, whose step response is a ramp.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> fit = armrig.oe(data, nb=4, nf=4, integrator=True)
        >>> response = fit.step_response(100, rate=True)
        >>> print(f"{response.y[-1]:.2f} rad/s per V")
        1.86 rad/s per V
        """
        require_integers(n=(n, 1))
        if self.Ts == 0:
            return self.to_discrete().step_response(n, rate=rate)
        t: Vector = self.Ts * (np.arange(n, dtype=np.float64) + 0.5 * rate)
        if (self.ny, self.nu) != (1, 1):
            y, std = np.zeros((2, n, self.ny, self.nu))
            for i, j, fit in self.channels():
                response = fit.step_response(n, rate=rate)
                y[:, i, j], std[:, i, j] = response.y, response.std
            return StepResponse(t=t, y=y, std=std, rate=rate)
        u = np.ones(n)
        if rate:
            u = np.zeros(n + 1)
            u[0] = 1 / self.Ts
        at = slice(int(rate), None)
        return StepResponse(
            t=t,
            y=self.simulate(u)[at],
            std=standard_deviations(sensitivity(self, u), self.trusted_covariance)[at],
            rate=rate,
        )

    def simulate(self, u: ArrayLike) -> Vector:
        """Return the model's output for the input u, from rest and without noise.

        u and the output are (N,) for one input and one output. For several signals u is (N, nu),
        and the output is (N, ny).

        u must not contain the input offset. If the offset was estimated, subtract `free[i].offset`,
        the offset of experiment i, from the measured input.

        u has the sampling time `Ts`; for a model in continuous time, that of the estimation data.
        For a model of detrended data, first subtract the mean of the
        estimation data's input from u. Add the mean of the output to the result, unless the output
        integrates. `Dataset.trends` contains both means.

        Raises
        ------
        ValueError
            u has another shape.

        Examples
        --------
        >>> import numpy as np
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> alpha = fit.simulate(4.0 * np.ones(200))
        >>> print(f"largest {abs(alpha).max():.2f} rad, at the end {abs(alpha[-1]):.2f} rad")
        largest 0.29 rad, at the end 0.00 rad
        """
        if self.Ts == 0:
            return self.to_discrete().simulate(u)
        if self.ny == self.nu == 1:
            return apply_filter(self.B, self.denominator, column("u", u))
        u_ = np.asarray(u, dtype=np.float64)
        u_ = u_[:, None] if u_.ndim == 1 else u_
        if u_.ndim != 2 or u_.shape[1] != self.nu:
            raise InputError(
                f"u has shape {np.shape(u)}; give (N, {self.nu}), a column for each of "
                f"{', '.join(self.inputs)}"
            )
        return self.form.innovations_form().deterministic.simulated(u_)

    def predict(self, data: Dataset | Signals, horizon: int | None = 1) -> Vector:
        """Return ŷ(t) from u up to t and y up to t - horizon; from u alone if horizon is None.

        ŷ is (N,) for one input and one output, otherwise (N, ny).

        The initial state is estimated from the data by least squares. With an integrator, or if the
        model has `offset`, the input offset is estimated too.

        After a missing sample a Kalman filter computes the predictions. Outputs that were estimated
        one by one are also predicted one by one; the others by the covariance of e of all outputs.
        If the noise is coloured, ŷ of an output is NaN before its first measured sample. A model
        without C has a finite memory: its initial state reproduces the first samples whatever their
        values are. There, and for the next `horizon` - 1 samples, ŷ is NaN, too.

        Raises
        ------
        ValueError
            The data have other signals, units or another sampling time than the model.

        Examples
        --------
        >>> import numpy as np
        >>> data = armrig.example_recording().dataset("alpha")
        >>> fit = armrig.arx(data, na=3, nb=3)
        >>> for horizon in (1, None):
        ...     error = data.y - fit.predict(data, horizon)
        ...     print(f"horizon {horizon}: rms error {np.sqrt(np.nanmean(error**2)):.3f} rad")
        horizon 1: rms error 0.009 rad
        horizon None: rms error 0.075 rad
        """
        from armrig.models.predictor import predictions

        return predictions(self, data, horizon)

    def state_space(self) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """Return A (n, n), B (n, nu), C (ny, n), D (ny, nu) and K (n, ny) of the innovations form.

        The innovations form is x(t+1) = A x(t) + B u(t) + K e(t), y(t) = C x(t) + D u(t) + e(t). A
        model of polynomials has the observer form. There the state x_k(t) of an ARMAX model is the
        sum of the terms with y, u and e before t in the difference equation of y(t + k - 1).

        Examples
        --------
        >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
        >>> A, B, C, D, K = fit.state_space()
        >>> A.round(1)
        array([[ 2.5,  1. ,  0. ],
               [-2.1,  0. ,  1. ],
               [ 0.6,  0. ,  0. ]])
        >>> C, D
        (array([[1., 0., 0.]]), array([[0.]]))
        """
        s = self.form.innovations_form()
        return s.A, s.B, s.C, s.D, s.K

    def to_discrete(self, Ts: float | None = None) -> Fit:
        """Return a model in continuous time, sampled exactly at Ts, with its covariance.

        The input is held between samples, or a straight line as in the estimation data. The
        covariance of the polynomials is J P J^T, with the derivatives J of the sampling. The noise
        model C/D is known only at the sampling time of the estimation data; at another Ts the noise
        is white.

        Parameters
        ----------
        Ts : float, optional
            Sampling time in s; that of the estimation data by default.

        Raises
        ------
        ValueError
            The model is sampled already, or Ts is not positive.

        References
        ----------
        .. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, section
           2.3.
        .. [2] A. H. Al-Mohy, N. J. Higham, SIAM J. Matrix Anal. Appl. 30 (2009) 1639-1657.

        Examples
        --------
        >>> fit = armrig.tf(armrig.example_recording().dataset("alpha"), poles=3, zeros=2)
        >>> fit.to_discrete(0.01).poles().values.round(2)
        array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
        """
        return discrete(self, Ts)

    def to_continuous(self) -> Fit:
        """Return the model in s whose sampled response is this model, with its covariance.

        Each pole is s = ln z / Ts, and the numerator follows from the exact sampling of a held
        input. The covariance is J P J^T, with J the inverse of the derivatives of the sampling.

        Raises
        ------
        ValueError
            A pole is 0 or real and negative, or B has more coefficients than poles.

        References
        ----------
        .. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, section
           2.3.

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> print(fit.to_continuous().quantities())
        gain                    ...
        time constant           0.0270... ± 0.00016 s
        natural frequency       18.8... ± 0.014 rad/s
        damping                 0.426... ± 0.00043
        ...
        """
        return continuous(self)

    def quantities(self) -> Quantities:
        """Return the physical numbers of the model with their standard deviations.

        The numbers are the gain B(0)/F(0), that of the rate if the output integrates, and the
        delay. A real pole s has the time constant -1/s. A pair has the natural frequency |s| and
        the damping ratio -Re s/|s|. Zeros have the same numbers. A sampled model is converted to
        continuous time first. The deviations are linearised.

        Raises
        ------
        ValueError
            A sampled model has no equivalent in continuous time.

        Examples
        --------
        >>> fit = armrig.tf(armrig.example_recording().dataset("alpha"), poles=3, zeros=2)
        >>> round(fit.quantities()["natural frequency"].value, 1)
        18...
        """
        return quantities(self)

    def to_control(self) -> control.TransferFunction | control.StateSpace:
        """Return the model from u to y as a python-control system with named signals and dt=Ts.

        A model in continuous time with a delay, which python-control does not have, is sampled. The
        system is a transfer function for polynomials of one input and one output, and a state
        space for N4SID, ss and several signals.

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> G = fit.to_control()
        >>> G.input_labels, G.output_labels, G.dt
        (['u'], ['alpha'], 0.01)
        >>> G.den[0][0].round(2)
        array([ 1.  , -2.51,  2.11, -0.59])
        """
        import control

        if isinstance(self.form, TransferFunction) and not self.form.delay:
            signals = {"inputs": list(self.inputs), "outputs": list(self.outputs)}
            return control.tf(self.B, self.F, **signals)
        if self.Ts == 0:
            return self.to_discrete().to_control()
        names = {"inputs": list(self.inputs), "outputs": list(self.outputs)}
        if (self.ny, self.nu) != (1, 1) or "order" in self.orders:
            s = self.form.innovations_form().deterministic
            return control.ss(s.A, s.B, s.C, s.D, self.Ts, **names)
        n = max(self.B.size, self.denominator.size)
        padded = [np.pad(p, (0, n - p.size)) for p in (self.B, self.denominator)]
        return control.tf(*padded, self.Ts, **names)

    def noise_to_control(self) -> control.TransferFunction:
        """Return the noise model H = C / (D A), from e to y, as a transfer function with dt=Ts.

        Examples
        --------
        >>> fit = armrig.armax(armrig.example_recording().dataset("alpha"), na=3, nb=3, nc=3)
        >>> H = fit.noise_to_control()
        >>> H.input_labels, H.output_labels, H.dt
        (['e'], ['alpha'], 0.01)
        >>> H.num[0][0].round(1)
        array([ 1. , -2.5,  2.1, -0.6])
        """
        import control

        D = np.convolve(self.D, self.A)
        n = max(self.C.size, D.size)
        Ts = self.Ts or self.to_discrete().Ts
        padded = [np.pad(p, (0, n - p.size)) for p in (self.C, D)]
        return control.tf(*padded, Ts, inputs=["e"], outputs=[self.output])

    def explain(self) -> str:
        """Return a text with the canonical correlations and the order that the data suggest.

        Examples
        --------
        >>> fit = armrig.n4sid(armrig.example_recording().dataset("alpha"))
        >>> print(fit.explain())
        canonical correlations of past and future:
           1   0.9999...
           2   0.999...
           3   0.994...  <- order
           4   0.25...
          ...
        the one-step errors suggest order 3 (MDL)
        """
        if self.projection is None:
            raise InputError(f"{self.label} has no canonical correlations; N4SID estimates them")
        values = self.projection.canonical_correlations[: max(10, self.order + 2)]
        lines = ["canonical correlations of past and future:"]
        lines += [
            f"  {k:2}  {value:8.5f}{'  <- order' if k == self.order else ''}"
            for k, value in enumerate(values, 1)
        ]
        lines.append(f"the one-step errors suggest order {self.projection.suggested_order} (MDL)")
        return "\n".join(lines)

    def summary(self) -> Summary:
        """Return poles, zeros, gain, bandwidth and times with 95 % ranges, as a table to print.

        The ranges are linearised, or computed by draws of the parameters if the linearisation is
        poor. See `armrig.numerics.confidence_regions`.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> print(armrig.oe(data, nb=4, nf=4, integrator=True).summary())
        95 % ranges, classic covariance; * by draws, as the linearisation is poor
          pole            1.0000, fixed
          pole            0.909... (0.908... … 0.909...)  ± 0.156... (0.156... … 0.157...) i
          ...
          gain (rate)     1.862... (1.862... … 1.862...) rad/V/s
          ...
        """
        from armrig.models.summary import summary

        return summary(self)

    def plot(self) -> Figure:
        """Return a figure of frequency and step response, poles and zeros, with 95 % regions.

        The figure of a model of several signals has the frequency response of each channel.

        `plot_bode`, `plot_step` and `plot_poles_zeros` of `armrig.plots` draw each panel alone, for
        several models or in your own axes.

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.plot()
        <Figure size ... with 4 Axes>
        """
        from armrig.models.figures import plot_fit

        return plot_fit(self)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model as JSON, with all digits of each number; `armrig.load_fit` reads it.

        The file also contains the hash of the recording and the treatment of its data.

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.save("alpha.json")
        >>> armrig.load_fit("alpha.json").heading
        'OE(nb=3, nf=3, nk=1)'
        """
        from armrig.models.model_writing import save_fit

        save_fit(self, path)

    def latex(self) -> str:
        r"""Return the equation with standard deviations as LaTeX, an `aligned` block.

        Examples
        --------
        >>> fit = armrig.arx(armrig.example_recording().dataset("alpha"), na=1, nb=1)
        >>> print(fit.latex())
        \begin{aligned}
        A(q)\,y(t) &= B(q)\,u(t) + e(t) \\
        A(q) &= 1 - (0.97... \pm 0.003...)\,q^{-1} \\
        B(q) &= -(0.0016... \pm 0.00016)\,q^{-1}
        \end{aligned}
        """
        from armrig.models.equation import latex

        return latex(self)

    def typst(self) -> str:
        r"""Return the equation with standard deviations as a block of Typst's mathematics.

        Examples
        --------
        >>> fit = armrig.arx(armrig.example_recording().dataset("alpha"), na=1, nb=1)
        >>> print(fit.typst())
        $ A(q) thin y(t) &= B(q) thin u(t) + e(t) \
          A(q) &= 1 - (0.97... plus.minus 0.003...) thin q^(-1) \
          B(q) &= -(0.0016... plus.minus 0.00016) thin q^(-1) $
        """
        from armrig.models.equation import typst

        return typst(self)

    def _repr_html_(self) -> str:
        """Return the model as HTML for a notebook."""
        from armrig.models.equation import html

        return html(self)

    def __repr__(self) -> str:
        """Return the model as a few lines of text with orders, equation and quality."""
        from armrig.models.equation import description

        return description(self)
