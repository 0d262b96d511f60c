"""Result of an estimation: a model with uncertainty, texts and figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from armrig.data.dataset import Dataset
from armrig.models.estimate import Estimate
from armrig.models.model import Vector

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.figure import Figure

    from armrig.models.summary import Summary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Fit(Estimate):
    """A model A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) with its uncertainty.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> fit = armrig.oe(data, nb=4, nf=4, integrator=True)
    >>> print(fit)
    OE(nb=4, nf=4, nk=1): u [V] to theta_1 [rad], Ts 0.01 s, N 2903
      y(t) = B(q)/F(q) u(t) + e(t)
      ...
      F has the factor 1 - q^-1 by construction
      fit 99.99 % one step ahead on estimation data, loss 1.25...e-05, ...
      residuals white (p = 0.5..., portmanteau test): trust std
      ...
    >>> fit.poles().values.round(2)
    array([1.  +0.j  , 0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """

    def predict(self, data: Dataset, horizon: int | None = 1) -> Vector:
        """Return ŷ(t) (N,) from u up to t and y up to t - horizon; from u alone if horizon is None.

        The initial state is estimated from the data by least squares. With an integrator, or if the
        model has `offset`, the input offset is estimated too. ŷ(t) is NaN if past samples that ŷ(t)
        needs are not known. For a model with A or D, but without C, ŷ is NaN at the beginning of an
        experiment. For a model with C or D, ŷ is NaN during a gap. If the model also has an
        integrator in A, ŷ is also NaN for at least the next `horizon` samples.

        Examples
        --------
        >>> import armrig, numpy as np
        >>> data = armrig.example_recording().dataset("alpha")
        >>> fit = armrig.arx(data, na=3, nb=3)
        >>> for horizon in (1, None):
        ...     error = data.y - fit.predict(data, horizon)
        ...     print(f"horizon {horizon}: rms error {np.sqrt(np.nanmean(error**2)):.3f} rad")
        horizon 1: rms error 0.009 rad
        horizon None: rms error 0.075 rad
        """
        from armrig.models.prediction import predicted

        return predicted(self, data, horizon)

    def summary(self) -> Summary:
        """Return poles, zeros, gain, bandwidth and times with 95 % ranges, as a table to print.

        The ranges are linearised, or computed by draws of the parameters if the linearisation is
        poor. See `armrig.numerics.confidence_regions`.

        Examples
        --------
        >>> import armrig
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

        `plot_bode`, `plot_step` and `plot_poles_zeros` of `armrig.plots` draw each panel alone, for
        several models or in your own axes.

        Examples
        --------
        >>> import armrig
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
        >>> import armrig
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
        >>> import armrig
        >>> fit = armrig.arx(armrig.example_recording().dataset("alpha"), na=1, nb=1)
        >>> print(fit.latex())
        \begin{aligned}
        A(q)\,y(t) &= B(q)\,u(t) + e(t) \\
        A(q) &= 1 - (0.97... \pm 0.003...)\,q^{-1} \\
        B(q) &= -(0.0016... \pm 0.00016)\,q^{-1}
        \end{aligned}
        """
        from armrig.models.markup import latex

        return latex(self)

    def typst(self) -> str:
        r"""Return the equation with standard deviations as a block of Typst's mathematics.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.arx(armrig.example_recording().dataset("alpha"), na=1, nb=1)
        >>> print(fit.typst())
        $ A(q) thin y(t) &= B(q) thin u(t) + e(t) \
          A(q) &= 1 - (0.97... plus.minus 0.003...) thin q^(-1) \
          B(q) &= -(0.0016... plus.minus 0.00016) thin q^(-1) $
        """
        from armrig.models.markup import typst

        return typst(self)

    def _repr_html_(self) -> str:
        """Return the model as HTML for a notebook."""
        from armrig.models.markup import html

        return html(self)

    def __repr__(self) -> str:
        """Return the model as a few lines of text with orders, equation and quality."""
        from armrig.models.equation import described

        return described(self)
