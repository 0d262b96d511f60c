"""Parameters, quality and uncertainty of a model: a `Fit` without responses, texts and figures."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import numpy as np
from armrig_core.errors import InputError

from armrig.data.finding import Finding
from armrig.models.matrices import Matrices
from armrig.models.polynomials import Polynomials
from armrig.models.state_space import Matrix, Vector, freeze
from armrig.models.structure import FreeResponse
from armrig.models.structure_table import DESCRIBED, orders_text
from armrig.models.transfer_function import TransferFunction
from armrig.numerics import criteria
from armrig.numerics.curvature import doubts
from armrig.numerics.inference import OutputQuality
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """One start value of the search, and its result."""

    name: str
    """Method that found the start value."""
    loss: float
    """Mean squared residual at the minimum that the search reached."""
    iterations: int
    """Number of steps of the search."""
    converged: bool
    """True if the change of the loss and the scaled gradient are within the tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Minimisation:
    """Search for the minimum of the loss."""

    converged: bool = True
    """True if the search converged within its tolerance."""
    starts: tuple[Start, ...] = ()
    """Start values with their results, best first; empty if no search was necessary."""
    agreed: bool = True
    """True if all starts led to the same minimum."""
    curvature: float = 0.0
    """Deviation of the loss from the parabola that `std` assumes: the standard deviation of the
    logarithm of the likelihood divided by that of the normal distribution. It is 0 for a linear
    regression and in older files."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PastProjection:
    """Projection of the future outputs on the past, by which N4SID determines the poles."""

    weights: str = ""
    """Weights of the projection: "cva", "moesp" or "n4sid"."""
    horizon: int = 0
    """Number of past samples in the projection; the number of future samples is equal."""
    singular_values: Vector = field(default_factory=lambda: np.zeros(0))
    """Singular values of the weighted projection, largest first, (horizon,)."""
    canonical_correlations: Vector = field(default_factory=lambda: np.zeros(0))
    """Canonical correlations of future and past, 0 to 1, at the longest horizon tried. They do not
    depend on `weights`: they are the singular values for the weights "cva"."""
    suggested_order: int = 0
    """Order with the least MDL, at most 10. MDL is computed from the one-step errors of the
    estimated states."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, ("singular_values", "canonical_correlations"))


Form = Polynomials | Matrices | TransferFunction
T = TypeVar("T")


def _of_form(getter: Callable[[Any], T], doc: str) -> T:
    """Return a property of the polynomials of the only channel."""
    return cast("T", property(lambda self: getter(self._polynomials), doc=doc))


def _of_quality(getter: Callable[[OutputQuality], T], doc: str) -> T:
    """Return a property of the quality of the only output."""
    return cast("T", property(lambda self: getter(self._quality), doc=doc))


def _of_only(name: str, doc: str) -> str:
    """Return a property of the only output or input, from the field of all of them."""
    return cast("str", property(lambda self: getattr(self, name)[self._only], doc=doc))


def _criterion(criterion: Callable[[float, int, int], Any], doc: str) -> float:
    """Return a property that compares models by loss, number of parameters and residuals."""
    value = property(lambda self: float(criterion(self.loss, self.parameters, self.N)), doc=doc)
    return cast("float", value)


# Not slotted: an assignment to a property of a frozen class with slots raises a TypeError.
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Estimate:
    """Parameters of a model with covariance, loss and results of the search.

    A model of one input and one output always has polynomials. A state space of one input and one
    output is converted to A y = B u + C e, or to y = B/F u + e without K.
    """

    structure: str
    """Name of a `structure_table.RegisteredStructure`, such as "oe", or of the origin of a model
    that was not estimated, such as "physics"."""
    form: Form
    """Parameters and equations: polynomials in q^-1, the matrices of a state space, or a transfer
    function in s."""
    specification: str = ""
    """Orders as text, such as "nb=[[2],[1]], nf=2, nk=1", for a model of several signals."""
    inputs: tuple[str, ...] = ("u",)
    """Names of the inputs."""
    outputs: tuple[str, ...] = ("y",)
    """Names of the outputs."""
    input_units: tuple[str, ...] = ("",)
    """Units of the inputs."""
    units: tuple[str, ...] = ("",)
    """Units of the outputs."""
    Ts: float
    """Sampling time, in s; 0 for a model in continuous time."""
    offset: bool = False
    """True if the input has an unknown offset, which is estimated again from each data set."""
    shared: bool = False
    """True if all outputs share one denominator."""
    output_weights: tuple[float, ...] = ()
    """Weights w_i if the estimator minimised the sum of w_i e_i²; empty if the weights were
    computed from the noise covariance."""
    covariance: Matrix
    """Covariance of theta (d, d), lambda (J^T J)^-1; valid if the residuals are white."""
    covariance_robust: Matrix
    """Covariance of theta (d, d), sandwich form; also valid if the residuals are coloured."""
    noise_covariance: Matrix
    """Covariance Lambda of e (ny, ny). Each variance is the sum of squared residuals divided by its
    degrees of freedom."""
    quality: tuple[OutputQuality, ...] = ()
    """Loss, fit and whiteness of each output; empty if the model was not estimated."""
    search: Minimisation = Minimisation()
    """Search for the minimum: whether it converged, its starts, and the curvature of the loss."""
    free: tuple[FreeResponse, ...] = ()
    """Initial state and input offset of each experiment, estimated with theta."""
    projection: PastProjection | None = None
    """Projection of N4SID, with its horizon and canonical correlations; None for other models."""
    findings: tuple[Finding, ...] = ()
    """Findings about the reliability of the numbers, with codes for programs."""
    source: str = ""
    """Hash of the recording or file that the model was identified from, or ""."""
    history: tuple[str, ...] = ()
    """Steps of the treatment of the estimation data, in order."""
    digest: str = ""
    """Fingerprint of the estimation data."""

    def __post_init__(self) -> None:
        """Make the arrays read-only, and convert a state space of one input and one output."""
        if isinstance(self.form, Matrices) and self.ny == self.nu == 1:
            form, J = self.form.channel(0, 0)
            object.__setattr__(self, "form", form)
            object.__setattr__(self, "specification", "")
            for name in ("covariance", "covariance_robust"):
                object.__setattr__(self, name, J @ getattr(self, name) @ J.T)
        freeze(self, ("covariance", "covariance_robust", "noise_covariance"))

    def __getattr__(self, name: str) -> Any:
        """Return a value by the name that it had in an earlier release, and warn."""
        for part, kind in (("search", Minimisation), ("projection", PastProjection)):
            if name in kind.__dataclass_fields__:
                text = f"fit.{name} is fit.{part}.{name} now; the earlier name ends with armrig 0.4"
                warnings.warn(text, DeprecationWarning, stacklevel=2)
                return getattr(getattr(self, part) or kind(), name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}", name=name)

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
        """Parameters (d,); for one input and one output a1 …, b1 …, c1 …, d1 …, f1 …."""
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
    def trusts_robust(self) -> bool:
        """True if the residuals are coloured, so that only the robust covariance is valid."""
        return any(q.white.coloured for q in self.quality)

    @property
    def trusts_coefficients(self) -> bool:
        """True if the standard deviations of the coefficients are valid."""
        coarse = any(finding.about == "converter" for finding in self.findings)
        return not self.doubts and not coarse

    @property
    def doubts(self) -> list[tuple[str, str]]:
        """Reasons to distrust the standard deviations of the coefficients, each with a name."""
        N = min((quality.N for quality in self.quality), default=0)
        both, coloured = (self.covariance, self.covariance_robust), self.trusts_robust
        return doubts(self.search.curvature, *both, N=N, coloured=coloured, outputs=self.ny)

    @property
    def trusted_covariance(self) -> Matrix:
        """`covariance_robust` if the residuals are coloured, otherwise `covariance`.

        Poles, zeros, frequency and step response use this covariance.
        """
        return self.covariance_robust if self.trusts_robust else self.covariance

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of the findings about the reliability of the numbers."""
        return tuple(f.text for f in self.findings)

    @property
    def label(self) -> str:
        """Structure and orders in the shortest form, such as OE[4 4 1]."""
        if self.structure in DESCRIBED and not self.specification:
            return DESCRIBED[self.structure].short(self.orders)
        return self.heading if self.specification else self.structure

    @property
    def heading(self) -> str:
        """Structure, and orders by their names, such as OE(nb=4, nf=4, nk=1)."""
        title = self.structure.upper() if self.quality else self.structure
        return f"{title}({self.specification or orders_text(self.orders)})"

    def estimated_from(self, data: Dataset | Signals) -> bool:
        """Return whether the model was estimated from these data.

        Examples
        --------
        >>> first, second = armrig.example_recording().dataset("alpha").split(2)
        >>> fit = armrig.oe(first, nb=3, nf=3)
        >>> fit.estimated_from(first), fit.estimated_from(second)
        (True, False)
        """
        return bool(self.digest) and self.digest == data.digest

    @property
    def _polynomials(self) -> Polynomials | TransferFunction:
        """Polynomials of the only channel."""
        if self.ny == self.nu == 1 and not isinstance(self.form, Matrices):
            return self.form
        raise InputError(
            f"the model has {plural(self.ny, 'output')} and {plural(self.nu, 'input')}: choose one "
            f"of each, such as fit[{self.outputs[-1]!r}, {self.inputs[-1]!r}]"
        )

    A = _of_form(lambda form: form.A[0][0], "Coefficients in q^-1, beginning with 1.")
    B = _of_form(lambda form: form.B[0][0], "Coefficients in q^-1, beginning with nk zeros.")
    C = _of_form(lambda form: form.C[0], "Coefficients in q^-1, beginning with 1.")
    D = _of_form(lambda form: form.D[0], "Coefficients in q^-1, beginning with 1.")
    F = _of_form(
        lambda form: form.F[0][0],
        "Coefficients in q^-1, beginning with 1; a root is exactly 1 if F has the integrator.",
    )
    nk = _of_form(lambda form: form.nk[0][0], "Number of samples before u affects y.")
    integrator = _of_form(
        lambda form: form.integrators[0],
        "True if F, or A if there is no F, has the factor 1 - q^-1 by construction.",
    )

    @property
    def integrating(self) -> Literal["", "a", "f"]:
        """Polynomial with the factor 1 - q^-1 by construction: "a", "f" or ""."""
        if not self.integrator:
            return ""
        return "f" if self.F.size > 1 else "a"

    @property
    def denominator(self) -> Vector:
        """Product A F, whose roots are the poles from u to y."""
        return np.convolve(self.A, self.F)

    def polynomial(self, letter: str) -> Vector:
        """Return the coefficients of one polynomial, "a" … "f", beginning with q^0.

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.polynomial("f").round(2)
        array([ 1.  , -2.51,  2.11, -0.59])
        """
        p: Vector = getattr(self, letter.upper())
        return p

    def slice_of(self, letter: str) -> slice:
        """Return the slice of theta with the parameters of one polynomial, "a" … "f".

        Examples
        --------
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.names[fit.slice_of("f")]
        ('f1', 'f2', 'f3')
        >>> fit.theta[fit.slice_of("f")].round(2)
        array([-2.51,  2.11, -0.59])
        """
        return self._polynomials.slice_of(letter, 0, 0)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of theta: a1 …, b1 …, c1 …, d1 …, f1 …."""
        form = self._polynomials
        if isinstance(form, TransferFunction):
            return form.names
        sizes = ((x, form.slice_of(x, 0, 0)) for x in "abcdf")
        return tuple(f"{x}{k + 1}" for x, part in sizes for k in range(part.stop - part.start))

    @property
    def orders(self) -> dict[str, int]:
        """Orders of the structure by name: na, nb, nc, nd, nf or order, and nk.

        A model in continuous time has poles and zeros, and nc and nd if they are not 0.

        A model that was not estimated has nb, nk and all orders that are not 0.
        """
        if isinstance(self.form, TransferFunction):
            noise = {"nc": self.C.size - 1, "nd": self.D.size - 1}
            degrees = {"poles": self.F.size - 1, "zeros": self.B.size - 1}
            return degrees | {name: n for name, n in noise.items() if n}
        sizes = {"na": self.A.size - 1, "nb": self.B.size - self.nk, "nc": self.C.size - 1}
        sizes |= {"nd": self.D.size - 1, "nf": self.F.size - 1, "nk": self.nk}
        if self.structure not in DESCRIBED:
            return {name: n for name, n in sizes.items() if n or name in ("nb", "nk")}
        sizes["order"] = self.order
        return {name: sizes[name] for name in DESCRIBED[self.structure].counts}

    @property
    def order(self) -> int:
        """Number of states; the states of a delay beyond one sample are not counted."""
        if isinstance(self.form, Matrices):
            return int(self.form.A.shape[0])
        return int(self.denominator.size) - 1

    @property
    def parameters(self) -> int:
        """Number of free parameters: d, or d - 1 if a root is 1 by construction."""
        return int(self.theta.size) - int(self.integrator)

    output = _of_only("outputs", "Name of the only output.")
    unit = _of_only("units", "Unit of the only output.")
    input_unit = _of_only("input_units", "Unit of the only input.")

    @property
    def noise_variance(self) -> float:
        """Estimate of lambda, the variance of e, in the squared unit of y."""
        return float(self.noise_covariance[self._only, self._only])

    @property
    def _quality(self) -> OutputQuality:
        """Quality of the only output."""
        if not self.quality:
            raise InputError(f"{self.label} was not estimated: it has no loss and no residuals")
        return self.quality[self._only]

    loss = _of_quality(
        lambda quality: quality.loss,
        "Mean squared residual, one step ahead, on the estimation data, in y's squared unit.",
    )
    N = _of_quality(lambda quality: quality.N, "Number of residuals in the loss.")
    fit_percent = _of_quality(
        lambda quality: quality.fit_percent,
        "100 (1 - |y - ŷ| / |y - mean y|), one step ahead, on the estimation data.",
    )
    white = _of_quality(
        lambda q: q.white, "Result of the whiteness test; str() returns it as text."
    )
    whiteness = _of_quality(lambda q: q.white.p_value, "Probability value p of the whiteness test.")
    whiteness_test = _of_quality(lambda q: q.white.test, "Name of the test of whiteness.")

    @property
    def _only(self) -> int:
        """Index 0 of the only channel; a model of several channels raises an error."""
        return len(self._polynomials.A) - 1

    fpe = _criterion(criteria.fpe, "Akaike's final prediction error, loss (1 + d/N) / (1 - d/N).")
    aic = _criterion(criteria.aic, "Akaike's criterion, -2 log likelihood + 2 d, for Gaussian e.")
    mdl = _criterion(
        criteria.mdl, "Rissanen's criterion (BIC), -2 log likelihood + d log N, for Gaussian e."
    )
