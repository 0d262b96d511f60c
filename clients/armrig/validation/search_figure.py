"""The figure of a search: the error of each model against its number of parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from armrig.canvas import GREY, INK, axes, finish, pens
from armrig.models.structure_table import KINDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.validation.search_result import SearchResult

_MARKERS = "osD^vP"
_MOST = 1e4
"""Errors of more than so many times the best are drawn at the upper edge."""


def plot_search(found: SearchResult, *, ax: Axes | None = None) -> Axes:
    """Show the mean squared error on the validation data over the number of parameters.

    The line is the best model of each number; below the dotted line is what one standard error
    of the best one does not tell from it, and the chosen one, the simplest of those, is ringed.
    """
    ax = axes(ax)
    n = np.array([one.parameters for one in found.ranked])
    loss = np.asarray(found.rms) ** 2
    shown = np.minimum(loss, _MOST * loss.min())
    families = np.array([one.candidate.family for one in found.ranked])
    for (colour, _), marker, family in zip(
        pens(), _MARKERS, dict.fromkeys(families.tolist()), strict=False
    ):
        of = families == family
        ax.plot(n[of], shown[of], marker, color=colour, ms=5, ls="", label=KINDS[family].title)
    counts = np.unique(n)
    ax.plot(counts, [shown[n == k].min() for k in counts], color=GREY, lw=0.9, zorder=0)
    within = loss[found.within].max()
    ax.axhline(within, color=GREY, ls=":", lw=1.0)
    i = found.chosen_index
    ax.plot(n[i], shown[i], "o", mfc="none", mec=INK, ms=12, mew=1.4)
    ax.annotate(
        found.chosen.candidate.name,
        (n[i], shown[i]),
        xytext=(0, -16),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize="small",
    )
    ax.set_yscale("log")
    bottom, top = ax.get_ylim()
    ax.set_ylim(bottom / (top / bottom) ** 0.15, top)  # room for the name
    ax.set_xlabel("number of parameters")
    ax.set_ylabel(f"mean squared error [{found.unit}²]" if found.unit else "mean squared error")
    ax.legend(loc="upper right", fontsize="small", ncols=3)
    finish(ax)
    return ax
