"""The estimators by the names of their structures."""

from __future__ import annotations

from collections.abc import Callable

from armrig.estimation.armax import armax
from armrig.estimation.arx import arx
from armrig.estimation.bj import bj
from armrig.estimation.iv4 import iv4
from armrig.estimation.n4sid import n4sid
from armrig.estimation.oe import oe
from armrig.estimation.pem import pem
from armrig.models.fit import Fit

ESTIMATORS: dict[str, Callable[..., Fit]] = {
    "arx": arx,
    "armax": armax,
    "oe": oe,
    "bj": bj,
    "iv4": iv4,
    "n4sid": n4sid,
    "pem": pem,
}
