"""Treatment of data before identification; each step is written into the data's history.

No step fills a gap: what is missing stays missing, and what a missing sample touches is missing
too. Each experiment is treated by itself.
"""

from armrig.preprocess.drift import Drift, drift
from armrig.preprocess.filtering import prefilter, resample
from armrig.preprocess.integration import (
    INTEGRATING_OUTPUTS,
    IntegratingOutputWarning,
    integrating,
)
from armrig.preprocess.outliers import hampel
from armrig.preprocess.rate import difference
from armrig.preprocess.trends import detrend, retrend

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
