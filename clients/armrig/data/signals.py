"""Name of the module of `Signals` until its users import it from `armrig.data.dataset`."""

from __future__ import annotations

from armrig.data.dataset import Signals as Signals
