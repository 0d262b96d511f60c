"""The step in which an output was read, from the numbers themselves."""

from __future__ import annotations

import numpy as np

from armrig.data.dataset import Dataset

ENOUGH_NOISE = 0.32
"""Noise, as a share of the step, from which on quantisation adds white noise of step²/12.

A third, less what the estimate of the noise may be off.
B. Widrow, I. Kollár, *Quantization Noise*, 2008, chapter 5: at this much Gaussian noise the first
moments of the error are those of uniform white noise to a few percent.
"""


def quantum(data: Dataset) -> float:
    """Return the step of which all changes between neighbours are multiples, 0 if there is none."""
    change = np.abs(np.diff(data.y))
    change = change[np.isfinite(change)]
    moved = change[change > 1e-9 * max(float(change.max(initial=0.0)), 1e-300)]
    if moved.size < 10:
        return 0.0
    step = float(moved.min())
    multiple = moved / step
    off = np.abs(multiple - np.round(multiple)) > 1e-4 * np.maximum(multiple, 1.0)
    return 0.0 if np.mean(off) > 1e-3 else step


def too_quiet(step: float, noise_variance: float) -> str:
    """Say so where the noise does not reach a third of the step, "" where it does."""
    if step == 0:
        return ""
    noise = float(np.sqrt(max(noise_variance - step**2 / 12, 0.0)))
    if noise >= ENOUGH_NOISE * step:
        return ""
    return (
        f"the noise is {noise / step:.2f} of the converter's step, less than a third: the error of "
        "quantisation is no white noise then, and the standard deviations are conservative"
    )
