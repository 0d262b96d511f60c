"""Was the input free of the output? (handout, assignment 3.7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.numerics.quantities import p_relation, percent
from armrig.validation.feedback_and_delay.sims import CannotTellError, Sims, sims

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SURE = 1e-3  # p value from which on another recording is asked for
_EXACT = 1e-5  # share of u's deviation that y(t) leaves at most: the digits of a file
_FEW_LEVELS = 20  # of u: a controller that carries noise into u makes more
_LARGE = 1e6  # F beyond which its digits say nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OpenLoop:
    """Whether y was fed back to u, at a stated level."""

    feedback: bool | None
    """p_value < level; None where these data cannot tell."""
    p_value: float
    """Of Sims' test: H0 is that no u from t on knows of y(t); NaN where it cannot be told."""
    level: float
    """Share of open-loop experiments that are called closed."""
    sims: Sims | None
    """The test in full."""
    exact: bool
    """u(t) is a multiple of y(t) and a constant, sample by sample, as under a P controller whose
    set point rests."""
    remarks: tuple[str, ...]
    """What limits the answer, or why there is none."""
    few_levels: bool
    """The input has 20 levels at most, so that it carries none of y's noise, but by a relay."""
    output: str
    """Name of y."""
    unit: str
    """Unit of y."""
    input_unit: str
    """Unit of u."""
    Ts: float
    """Sampling time, in s."""
    source: str
    """Hash of the recording, or ""."""

    @property
    def verdict(self) -> str:
        """The answer in a few words."""
        if self.feedback is None:
            return "cannot tell whether there is feedback"
        return "FEEDBACK" if self.feedback else "open loop: no feedback found"

    @property
    def may_be_direct_term(self) -> bool:
        """Only u(t) tells, none after it: a rig that answers within the sample looks the same."""
        s = self.sims
        return s is not None and not self.exact and s.p_value < self.level <= s.p_later

    def explain(self) -> str:
        """Say what was asked, what came out, and what it can and cannot mean."""
        if self.sims is None:
            return "\n".join([f"{self.verdict}.", *(f"{r}." for r in self.remarks)])
        s, y = self.sims, self.output
        lines = [
            f"{self.verdict}.",
            f"Asked: does the input from t on know of {y}(t) what the past does not? In open loop "
            f"it does not: u was chosen without looking at {y}.",
            self._found(s),
        ]
        if self.feedback:
            lines += self._so()
        else:
            lines.append(
                f"So nothing speaks against open loop, at a level of {100 * self.level:g} %. That "
                "is no proof: feedback shows by the noise that it carries into u, and goes unseen "
                "where that is little beside the rest of u."
            )
        return "\n".join([*lines, *(f"Note: {r}." for r in self.remarks)])

    def brief(self) -> str:
        """Say the answer, what to do where there is feedback, and what limits the answer."""
        verdict, *notes = repr(self).splitlines()
        return "\n".join([verdict, *(self._so() if self.feedback else []), *notes])

    def _found(self, s: Sims) -> str:
        if self.exact:
            return f"Found: u(t) follows from {self.output}(t) exactly, in all samples."
        F = f"{s.F:.3g}" if s.F < _LARGE else f"more than {_LARGE:.0e}"
        return (
            f"Found: it explains {percent(100 * max(s.explained, 0.0))} of what the past leaves of "
            f"{self.output}; F = {F} with {s.q} and {s.degrees} degrees of freedom, p "
            f"{p_relation(self.p_value)}."
        )

    def _so(self) -> list[str]:
        """Return what follows from feedback."""
        lines = [
            f"So there is feedback, at a level of {100 * self.level:g} %. A model that assumes an "
            "input free of the noise (OE, spectral analysis, correlation) is then biased: "
            "estimate with a noise model (ARMAX, BJ), or record with the controller off."
        ]
        if self.p_value >= _SURE:
            lines.append(
                f"But one open-loop experiment in {1 / self.level:.0f} fails by chance, and p is "
                "not far below the level: record another one, and see whether it says so again."
            )
        return lines

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of how y regresses on u: see `armrig.plots.plot_open_loop`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.feedback_and_delay.figures import plot_open_loop

        return figure_of(plot_open_loop(self, ax=ax))

    def __repr__(self) -> str:
        """Say it in a line or two."""
        how = ""
        if self.sims is not None:
            how = f" (Sims' F-test of {self.output} on future u: p {p_relation(self.p_value)}, "
            how += f"level {100 * self.level:g} %)"
        return "\n".join([f"{self.verdict}{how}", *(f"  note: {r}" for r in self.remarks)])


def require_level(level: float) -> None:
    """Refuse a level of significance that is none."""
    if not 0 < level < 1:
        raise InputError(f"level={level!r} must lie between 0 and 1, such as 0.05")


@takes_recordings
def open_loop(data: Dataset, level: float = 0.05) -> OpenLoop:
    """Test whether the rig ran in open loop (`sims`): nothing in u from t on knows of y(t).

    Feedback is found by the noise that the controller carries from y into u, and by nothing else:
    without noise, closed and open loop cannot be told apart.

    Parameters
    ----------
    data : Dataset
        u and y as applied and measured; y(t) is read before u(t) is applied. Missing samples cost
        their own rows, and nothing is carried from one experiment to the next.
    level : float, default 0.05
        Between 0 and 1.

    Returns
    -------
    OpenLoop
        .feedback (None where u follows from its own past, or y has no noise), .p_value,
        .explain(), .plot().

    Raises
    ------
    ValueError
        level is outside 0 to 1, or there are too few samples.

    References
    ----------
    .. [1] C. A. Sims, American Economic Review 62 (1972) 540-552.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 13.4.
    """
    require_level(level)
    found: Sims | None = None
    remarks: tuple[str, ...] = ()
    try:
        found = sims(data)
    except CannotTellError as err:
        remarks = (str(err),)
    exact = found is not None and _is_exact(data)
    if found is not None and found.p_value < level:
        remarks = _remarks(found, level, exact=exact)
    return OpenLoop(
        feedback=None if found is None else found.p_value < level,
        p_value=float("nan") if found is None else found.p_value,
        level=level,
        sims=found,
        exact=exact,
        few_levels=np.unique(data.u).size <= _FEW_LEVELS,
        remarks=remarks,
        output=data.output,
        unit=data.unit,
        input_unit=data.input_unit,
        Ts=data.Ts,
        source=data.source,
    )


def _is_exact(data: Dataset) -> bool:
    """Tell whether u(t) is a multiple of y(t) and a constant."""
    u, y = data.u[data.valid], data.y[data.valid]
    if u.size < 2 or np.ptp(u) == 0 or np.ptp(y) == 0:
        return False
    u, y = u - u.mean(), y - y.mean()
    left = u - (u @ y) / (y @ y) * y
    return bool(np.linalg.norm(left) < _EXACT * np.linalg.norm(u))


def _remarks(found: Sims, level: float, *, exact: bool) -> tuple[str, ...]:
    """Say where u is made of y(t), or only u(t) tells, which may be the rig's answer as well."""
    if exact:
        return (
            "u(t) is a multiple of y(t) and a constant, as a P controller makes it whose set "
            "point rests: such data tell the controller, not the rig; move the set point",
        )
    if found.p_value < level <= found.p_later:
        return (
            "only u(t) itself tells, none after it: a rig that answers within the sample (nk = 0, "
            "y read after u is applied) looks the same",
        )
    return ()
