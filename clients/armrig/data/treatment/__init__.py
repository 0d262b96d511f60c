"""Treatment of data before identification; the data's history contains each step.

No step fills a gap: a missing sample stays missing. A result that depends on a missing sample is
missing, too. Each experiment is treated separately.
"""

from armrig.data.treatment.detrending import Drift as Drift
from armrig.data.treatment.detrending import detrend as detrend
from armrig.data.treatment.detrending import drift as drift
from armrig.data.treatment.detrending import retrend as retrend
from armrig.data.treatment.filtering import prefilter as prefilter
from armrig.data.treatment.filtering import resample as resample
from armrig.data.treatment.integrating import IntegratingOutputWarning as IntegratingOutputWarning
from armrig.data.treatment.integrating import difference as difference
from armrig.data.treatment.integrating import integrates_by_name as integrates_by_name
from armrig.data.treatment.integrating import integrating as integrating
from armrig.data.treatment.outliers import hampel as hampel
