"""Treatment of data before identification; the data's history contains each step.

No step fills a gap: a missing sample stays missing. A result that depends on a missing sample is
missing, too. Each experiment is treated separately.
"""

from armrig.data.treatment.detrending import detrend, retrend
from armrig.data.treatment.drift import Drift, drift
from armrig.data.treatment.filtering import prefilter, resample
from armrig.data.treatment.integrating import (
    INTEGRATING_OUTPUTS,
    IntegratingOutputWarning,
    difference,
    integrating,
)
from armrig.data.treatment.wrong_samples import hampel

__all__ = [
    "INTEGRATING_OUTPUTS",
    "Drift",
    "IntegratingOutputWarning",
    "detrend",
    "difference",
    "drift",
    "hampel",
    "integrating",
    "prefilter",
    "resample",
    "retrend",
]
