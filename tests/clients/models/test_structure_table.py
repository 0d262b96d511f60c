"""The table of structures, against the estimators that it names."""

from __future__ import annotations

import inspect
from typing import get_args

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.request import estimator
from armrig.models.structure_table import (
    OFFERED,
    OFFERED_NAMES,
    STRUCTURES,
    RegisteredStructure,
    StructureName,
    orders_text,
)
from armrig.numerics.polynomial import apply_filter

from tests.clients import pages

EVERY = pytest.mark.parametrize("kind", STRUCTURES.values(), ids=STRUCTURES.keys())


def test_each_structure_has_one_row_and_one_estimator() -> None:
    assert set(STRUCTURES) == set(get_args(StructureName)) == {*OFFERED_NAMES, "pem"}


@EVERY
def test_an_estimator_has_the_arguments_of_its_row(kind: RegisteredStructure) -> None:
    taken = inspect.signature(estimator(kind.name)).parameters

    assert set(taken) == {"data", *kind.counts, *kind.takes}
    assert kind.poles in kind.orders or not kind.orders


def test_the_page_contains_the_table_of_structures() -> None:
    page = (pages.DOCS / "experiments.md").read_text(encoding="utf-8")

    assert "\n".join(_row(kind) for kind in OFFERED.values()) in page


def _row(kind: RegisteredStructure) -> str:
    orders = orders_text(kind.orders) or f"{', '.join(kind.orders)}, by the data" * bool(
        kind.orders
    )
    cells = [kind.title, kind.equation, orders, ", ".join(kind.takes)]
    return f"| {' | '.join(cells)} | {'yes' if kind.closed_loop else 'biased'} |"


@pytest.mark.parametrize("kind", [kind for kind in STRUCTURES.values() if not kind.continuous])
def test_a_fit_has_the_orders_and_the_label_of_its_row(kind: RegisteredStructure) -> None:
    u, e = np.random.default_rng(0).standard_normal((2, 400))
    data = Dataset(u=u, y=apply_filter([0, 1.0, 0.5], [1, -1.2, 0.6], u) + 0.3 * e, Ts=0.1)
    orders = {name: 1 if name in ("nc", "nd") else 2 for name in kind.orders}
    orders |= {"na": 0} if kind.name == "pem" else {}
    options = {"starts": "few"} if "starts" in kind.takes else {}

    fit = estimator(kind.name)(data, **orders, nk=1, **options)

    assert fit.structure == kind.name
    assert fit.orders == orders | {"nk": 1}
    assert list(fit.orders) == [*kind.orders, "nk"]
    values = " ".join(str(n) for n in fit.orders.values())
    assert fit.label == f"{kind.name.upper()}[{values}]"
    assert repr(fit).startswith(f"{kind.name.upper()}({orders_text(fit.orders)}): u ")
