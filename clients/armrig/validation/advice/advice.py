"""The advice itself: each point that was looked at, what was found, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

from armrig.data.argument import HasDataset, as_dataset
from armrig.data.dataset import Dataset
from armrig.data.finding import Finding
from armrig.models.fit import Fit
from armrig.validation.advice.data_advice import examine_data
from armrig.validation.advice.model_advice import examine_model


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Advice:
    """What `advice` found; its repr says it in words."""

    of: str
    """What was looked at."""
    findings: tuple[Finding, ...]
    """All points, good ones too."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to do something about."""
        return tuple(f.text for f in self.findings if f.level != "good")

    def explain(self) -> str:
        """Say it, a line a point, those to act on first."""
        ranked = sorted(self.findings, key=lambda f: f.level == "good")
        width = max((len(f.about) for f in ranked), default=0)
        return "\n".join(
            f"{' ' if f.level == 'good' else '!'} {f.about:{width}}  {f.text}" for f in ranked
        )

    def __repr__(self) -> str:
        """Say it in a few lines."""
        count = len(self.warnings)
        said = f"{count} to act on" if count else "nothing to act on"
        return f"advice on {self.of}: {said}\n{self.explain()}"


def advice(data_or_fit: Dataset | HasDataset | Fit) -> Advice:
    """Look at data, or at a model, as a colleague would before trusting them.

    Data: excitation, integrator, missing samples, outliers, drift, feedback, and whether ARX and
    OE tell the same. A model: search, residuals, poles and zeros that cannot be told apart (an
    order too high), poles that no sampled rig has (negative real, unstable), an integrator left
    to chance, a first coefficient that is not there (a delay).

    Parameters
    ----------
    data_or_fit : Dataset, Recording or Fit
        What to judge.

    Returns
    -------
    Advice
        .findings, .warnings, and its repr in words.

    Raises
    ------
    TypeError
        It is neither.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, chapters 14 and 16.
    """
    if not isinstance(data_or_fit, Fit):
        data = as_dataset(data_or_fit)
        return Advice(of=f"{data.N} samples of {data.output}", findings=tuple(examine_data(data)))
    fit = data_or_fit
    return Advice(of=f"{fit.label} of {fit.output}", findings=tuple(examine_model(fit)))
