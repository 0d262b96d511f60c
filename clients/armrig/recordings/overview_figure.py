"""The first figure of a recording: all signals against time, one below the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np
from armrig_core.errors import InputError
from armrig_core.telemetry import ALPHA, THETA_1, VELOCITY
from numpy.typing import NDArray

from armrig.plots.captions import NAMES, legend, sign
from armrig.plots.colours import BLUE, INK, VERMILION
from armrig.plots.layout import finish, rows, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.recordings.recording import Recording


class Overview(Protocol):
    """What is drawn: see `armrig.recordings.overview`, whose fields say more."""

    @property
    def recording(self) -> Recording:
        """Its signals."""

    @property
    def outliers(self) -> Mapping[str, NDArray[np.float64]]:
        """Times in s, by output."""


def plot_overview(found: Overview, *, ax: Axes | None = None) -> Axes:
    """Show u, theta_1, its rate and alpha against time.

    Shaded is where a sample is missing or shows no angle, at u of either angle; outliers are
    ringed.
    """
    rec = found.recording
    if not rec.N:
        raise InputError(
            f"{rec.path}: it has no samples, so there is nothing to draw; record again"
        )
    every = rows(ax, 4)
    ax, first, last = every[0], float(rec.t[0]), float(rec.t[-1])
    rate = np.diff(rec.theta_1, prepend=np.nan) / rec.Ts
    ax.step(rec.t, rec.u, where="post", color=INK, lw=0.7)
    shade(ax, rec.valid & rec.valid_alpha, rec.Ts, first=first)
    signals = (
        (THETA_1, rec.theta_1, rec.valid, f"{NAMES[THETA_1]} [rad]"),
        (VELOCITY, rate, rec.valid, f"{NAMES[VELOCITY]} [rad/s]"),
        (ALPHA, rec.alpha, rec.valid_alpha, f"{NAMES[ALPHA]} [rad]"),
    )
    ax.set_ylabel("$u$ [V]")
    for panel, (name, y, valid, label) in zip(every[1:], signals, strict=True):
        panel.plot(rec.t, y, color=BLUE, lw=0.7)
        panel.set_ylabel(label)
        shade(panel, valid, rec.Ts, first=first)
        _ring(panel, found, name, y)
    every[-1].set_xlabel("$t$ [s]")
    finish(*every, xlim=(first, last if last > first else first + 1.0))
    return sign(ax, rec.sha256, above=legend(ax))


def _ring(panel: Axes, found: Overview, name: str, y: np.ndarray) -> None:
    """Draw a ring around each outlier of a signal."""
    times = found.outliers.get(name, np.zeros(0))
    at = np.searchsorted(found.recording.t, times)
    if at.size:
        label = f"{at.size} outliers" if at.size > 1 else "an outlier"
        panel.plot(times, y[at], "o", mfc="none", mec=VERMILION, ms=7, label=label)
        panel.legend(loc="upper right", fontsize="small")
