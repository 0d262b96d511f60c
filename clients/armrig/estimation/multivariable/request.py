"""Request for a model of several signals, with the orders and options of a command.

This module does not import numpy, because `--help` imports it and must be fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import msgspec
from armrig_core.errors import InputError

from armrig.estimation.orders import require_sensible
from armrig.models.structure_table import OF_SEVERAL, CommandName, Weights

if TYPE_CHECKING:
    from armrig.data.signals import Signals
    from armrig.models.fit import Fit

_COUNTS_INTEGRATOR = ("na", "nb", "nf")
"""Orders that are lower by one for an output that does not integrate."""
_DENOMINATORS = ("na", "nf")
"""Orders of the denominators."""


class SignalsRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Structure and orders of a model; all outputs and inputs have the same orders.

    If an output integrates, the orders also count the root at 1 of this output. The orders na, nb
    and nf of the outputs that do not integrate are then lower by one. In the rig, for example, the
    transfer function to alpha has one pole and one coefficient of B fewer than the transfer
    function to theta_1.
    """

    structure: CommandName
    orders: dict[str, int | None]
    """Orders by name, except nk; None means that the order is chosen from the data."""
    nk: int = 1
    weights: Weights | None = None
    noise: bool = True
    """True if a state-space model also has the gain K of the innovations."""
    integrating: tuple[str, ...] = ()
    """Outputs with a pole at exactly 1."""
    shared: bool = False
    """True if all outputs have one denominator."""

    def arguments(self, data: Signals) -> dict[str, Any]:
        """Return the arguments of the estimator.

        Raises
        ------
        ValueError
            An order is too low or too high.
        """
        given = {name: n for name, n in self.orders.items() if n is not None}
        require_sensible(samples=data.N, nk=self.nk, integrator=bool(self.integrating), **given)
        orders: dict[str, Any] = dict(given)
        if self.integrating:
            for name in [x for x in _COUNTS_INTEGRATOR if x in given]:
                orders[name] = self._without_root(name, given[name], data)
        takes = OF_SEVERAL[self.structure].takes_several or ()
        options = {
            "weights": self.weights or "cva",
            "integrator": self.integrating,
            "shared": "denominator" if self.shared else "",
            "noise": self.noise,
        }
        return orders | {"nk": self.nk} | {name: x for name, x in options.items() if name in takes}

    def _without_root(self, name: str, n: int, data: Signals) -> Any:
        """Return the order n for each channel, lowered by one if the output has no integrator."""
        if name in _DENOMINATORS and self.shared:
            return n - 1
        others = [output for output in data.outputs if output not in self.integrating]
        if others and n < 2:
            raise InputError(
                f"{name}={n} leaves no coefficient for {', '.join(others)}, because {name} also "
                f"counts the integrator of {', '.join(self.integrating)}; give {name} >= 2"
            )
        each = {output: n - (output in others) for output in data.outputs}
        if name == "na":
            return each
        return {(output, input): each[output] for output in data.outputs for input in data.inputs}

    def estimated(self, data: Signals) -> Fit:
        """Return the model estimated from the data."""
        module = import_module(f"armrig.estimation.{self.structure}")
        fit: Fit = getattr(module, self.structure)(data, **self.arguments(data))
        return fit
