"""Figure of an order table: loss against number of parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.criteria import Criterion
from armrig.plots.captions import legend
from armrig.plots.layout import BLUE, GREY, VERMILION, axes, finish, logarithmic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.estimation.order_table import OrderTable

Vector = NDArray[np.float64]
Integers = NDArray[np.int_]


def plot_orders(
    table: OrderTable, criterion: Criterion | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plot the best structure for each number of parameters, and the choice of each criterion.

    The ordinate is the one-step loss divided by the least loss. If there are validation data, the
    losses are computed on these data.
    """
    ax = axes(ax)
    on_other = table.validation_loss is not None
    loss = table.loss if table.validation_loss is None else table.validation_loss
    share = loss / float(np.nanmin(np.where(np.isfinite(loss) & (loss > 0), loss, np.nan)))
    d = table.parameters
    best = table.envelope(criterion)
    shown = np.isfinite(share)
    ax.plot(d[shown], share[shown], ".", color=GREY, ms=4, alpha=0.5, label="all structures")
    ax.plot(d[best], share[best], "o-", color=BLUE, ms=4, lw=1.0, label="best for each number")
    chosen: dict[int, list[str]] = {}
    for name in table.criteria:
        chosen.setdefault(table.chosen(name), []).append(name)
    for k, (i, names) in enumerate(sorted(chosen.items(), key=lambda x: int(d[x[0]]))):
        o = table.orders(i)
        label = ", ".join(x.upper() if x != "validation" else x for x in names)
        ax.plot(d[i], share[i], "s", color=VERMILION, ms=8, mfc="none", mew=1.4)
        ax.annotate(
            f"{label} [{o.na} {o.nb} {o.nk}]",
            (d[i], share[i]),
            xytext=(0, -14 - 13 * k),
            textcoords="offset points",
            ha="right" if d[i] > 0.6 * d.max() else "left",
            fontsize="small",
            bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0},
            arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.6},
        )
    top = float(share[best].max()) if best.size else 1.0
    logarithmic(ax.yaxis, 0.6, max(1.5 * top, 2.5))
    ax.locator_params(axis="x", integer=True)
    ax.set_xlabel("number of parameters, $n_a + n_b$")
    ax.set_ylabel(f"loss{' on validation data' if on_other else ''} over the least loss")
    finish(ax)
    legend(ax)
    return ax
