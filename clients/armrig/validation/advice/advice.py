"""Advice on data or on a model: findings, each with its remedy."""

from __future__ import annotations

from dataclasses import dataclass, replace

from armrig.data.argument import HasDataset, as_dataset
from armrig.data.dataset import Dataset
from armrig.data.finding import Finding
from armrig.models.fit import Fit
from armrig.validation.advice.data_advice import examine_data
from armrig.validation.advice.model_advice import examine_model
from armrig.validation.feedback_and_delay.by_channel import ByChannel, each_channel


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Advice:
    """Findings of `advice`; its repr prints them."""

    of: str
    """Subject of the advice."""
    findings: tuple[Finding, ...]
    """All findings, also those of level "good"."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of the findings that need action."""
        return tuple(f.text for f in self.findings if f.level != "good")

    def explain(self) -> str:
        """Return a line for each finding; the findings that need action are first."""
        ranked = sorted(self.findings, key=lambda f: f.level == "good")
        width = max((len(f.about) for f in ranked), default=0)
        return "\n".join(
            f"{' ' if f.level == 'good' else '!'} {f.about:{width}}  {f.text}" for f in ranked
        )

    def __repr__(self) -> str:
        """Return a count and the findings."""
        count = len(self.warnings)
        said = f"{count} to act on" if count else "nothing to act on"
        return f"advice on {self.of}: {said}\n{self.explain()}"


@each_channel()
def advice(data_or_fit: Dataset | HasDataset | Fit) -> Advice:
    """Examine data or a model, and return the findings with their remedies.

    For data, the advice covers excitation, integrator, missing samples, outliers, drift, feedback,
    and the agreement of ARX with OE. For a model, the advice covers the search, the residuals, and
    an integrator that is not fixed. The advice also covers poles and zeros that cancel (the order
    is too high), and poles that no sampled rig has (negative real, unstable). Finally, the advice
    covers a first coefficient of B that may be 0 (a delay).

    Parameters
    ----------
    data_or_fit : Dataset, Signals, Recording or Fit
        Data or model to examine. Each channel of several signals is examined separately; in the
        data of a channel, the other inputs are part of the noise.

    Returns
    -------
    Advice
        Its fields are .findings and .warnings; its repr prints the findings. For several signals,
        the result is `ByChannel`: `found["alpha", "u"]` is the advice on one channel.

    Raises
    ------
    TypeError
        The argument is neither data nor a model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, chapters 14 and 16.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> print(armrig.advice(armrig.oe(data, nb=3, nf=3)))
    advice on OE[3 3 1] of alpha: nothing to act on
      search     one minimum
      residuals  residuals white (p = 0.10..., portmanteau test): trust the ordinary deviations
      order      no pole is cancelled by a zero
    """
    if not isinstance(data_or_fit, Fit):
        data = as_dataset(data_or_fit)
        return Advice(of=f"{data.N} samples of {data.output}", findings=tuple(examine_data(data)))
    fit = data_or_fit
    if (fit.ny, fit.nu) != (1, 1):
        each = {
            (fit.outputs[i], fit.inputs[j]): advice(replace(one, starts=fit.starts))
            for i, j, one in fit.channels()
        }
        return ByChannel(results=each, refused={})  # type: ignore[return-value]
    return Advice(of=f"{fit.label} of {fit.output}", findings=tuple(examine_model(fit)))
