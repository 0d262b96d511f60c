"""Plan of an estimate: the equation of each output, and the polynomials that outputs share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from armrig_core.errors import InputError

from armrig.data.signals import Signals
from armrig.estimation.multivariable.orders import Integers
from armrig.estimation.multivariable.problem import ONE, Row
from armrig.estimation.multivariable.search import Plan

Shared = Literal["", "denominator"]


def integrating_outputs(integrator: bool | str | Sequence[str], data: Signals) -> tuple[bool, ...]:
    """Return whether each output integrates.

    Raises
    ------
    ValueError
        `integrator` names an unknown output.
    """
    if isinstance(integrator, bool):
        return (integrator,) * data.ny
    names = (integrator,) if isinstance(integrator, str) else tuple(integrator)
    if unknown := [name for name in names if name not in data.outputs]:
        raise InputError(
            f"integrator={integrator!r}: there is no output {unknown[0]!r}; there are "
            f"{', '.join(data.outputs)}"
        )
    return tuple(name in names for name in data.outputs)


def plans_of(
    data: Signals,
    orders: dict[str, Integers],
    *,
    integrators: tuple[bool, ...],
    initial: str,
    shared: Shared,
    equation_error: bool = False,
) -> list[Plan]:
    """Return one plan for each output, or one plan for all outputs with a shared denominator.

    Parameters
    ----------
    orders : dict
        Arrays nb, nk and nf (ny, nu), and nc and nd (ny,), by name. For an ARMAX model, nf contains
        na.
    equation_error : bool
        True if F and D of each row are the same polynomial.
    """
    if initial not in ("estimate", "zero"):
        raise InputError(f'initial={initial!r} must be "estimate" or "zero"')
    if shared not in get_args(Shared):
        raise InputError(f'shared={shared!r} must be "denominator", or "" for none')
    nb, nf, nk = orders["nb"], orders["nf"], orders["nk"]
    none = np.zeros(data.ny, dtype=np.int_)
    nc, nd = orders.get("nc", none), orders.get("nd", none)
    for name, row in zip(data.outputs, nb, strict=True):
        if not row.any():
            raise InputError(f"nb is 0 for all inputs of {name}; leave this output out")
    inside = np.zeros(data.ny, dtype=np.int_) if shared else np.array(integrators, dtype=np.int_)
    if (nf < inside[:, None]).any():
        name = "na" if equation_error else "nf"
        raise InputError(
            f"{name} must be at least 1 with an integrator, because it also counts the root at 1"
        )
    if shared and not (nf == nf[0, 0]).all():
        raise InputError(f"nf={nf.tolist()}: outputs that share a denominator need one order nf")
    groups = [range(data.ny)] if shared else [range(i, i + 1) for i in range(data.ny)]
    plans = []
    for outputs in groups:
        sizes, bounded = [0], [False]

        def added(n: int, *, stable: bool, sizes: list[int] = sizes) -> int:
            if n == 0:
                return ONE
            sizes.append(n)
            bounded.append(stable)  # noqa: B023 - used within the loop
            return len(sizes) - 1

        common = added(int(nf[0, 0]), stable=True) if shared else ONE
        rows = []
        for i in outputs:
            free = [int(n) - int(inside[i]) for n in nf[i]]
            if shared:
                f = [common] * data.nu
            elif equation_error:
                f = [added(free[0], stable=True)] * data.nu
            else:
                f = [added(n, stable=True) if b else ONE for n, b in zip(free, nb[i], strict=True)]
            c = added(int(nc[i]), stable=True)
            d = f[0] if equation_error else added(int(nd[i]), stable=False)
            rows.append(
                Row(
                    nb=tuple(nb[i].tolist()),
                    nk=tuple(nk[i].tolist()),
                    f=tuple(f),
                    c=c,
                    d=d,
                    integrator=integrators[i],
                    integrated_noise=equation_error and integrators[i],
                    at_rest=initial == "zero",
                )
            )
        plans.append(
            Plan(
                outputs=tuple(outputs),
                rows=tuple(rows),
                sizes=tuple(sizes),
                bounded=tuple(bounded),
            )
        )
    return plans
