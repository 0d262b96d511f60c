"""Treatment of data before identification; each step is written into the data's history.

No step fills a gap: what is missing stays missing, and what a missing sample touches is missing
too. Each experiment is treated by itself.
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
