"""Black-box study: choice of the data, estimation of the models, comparison with other data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from armrig_core.errors import FileError, InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.channels import symbol
from armrig_core.rig.description import Input
from armrig_core.telemetry.channels import ARM_OUTPUTS, BODIES, INTEGRATING_OUTPUTS

from armrig.data.dataset import Dataset, Signals, Vector
from armrig.data.treatment import detrend
from armrig.data.treatment.integrating import integration
from armrig.estimation.arx import arx
from armrig.estimation.polynomial_structures import armax, oe
from armrig.estimation.request import require_sensible
from armrig.estimation.transfer_functions import process
from armrig.models.fit import Fit
from armrig.models.structure_table import ARM_POLES
from armrig.physics.systems import physical_model
from armrig.recordings.findings import second_moves
from armrig.recordings.recording import Recording
from armrig.recordings.usability import NO_MODEL
from armrig.validation.comparison import Comparison, compare
from armrig.validation.residual_test import ResidualTest
from armrig.validation.residuals import residuals
from armrig.validation.structure_hints import structure_hints

OUTPUTS: Final = {name: f"{body} angle" for name, body in BODIES.items()}
"""Names of the arm's outputs in the sentences of a report."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Orders:
    """Orders of the models of an output that integrates; the arm has four poles.

    The models of another output of the arm have one pole less and one coefficient of B less,
    because they have no integrator.
    """

    na: int = ARM_POLES
    """Number of coefficients a_k of the ARX model."""
    nb: int = ARM_POLES
    """Number of coefficients b_k of both models."""
    nf: int = ARM_POLES
    """Number of coefficients f_k of the OE model, including the coefficient of an integrator."""
    nk: int = 1
    """Number of samples before u affects y, in both models."""
    integrator: bool = True
    """True if the OE model has a fixed integrator; all poles of the ARX model are estimated."""
    form: str = ""
    """Form of an additional process model, such as "P1D"."""

    def of(self, output: str) -> Orders:
        """Return the orders of the models of one output."""
        if output not in ARM_OUTPUTS - INTEGRATING_OUTPUTS:
            return self
        na, nb, nf = (n - 1 for n in (self.na, self.nb, self.nf))
        if min(na, nb, nf) < 1:
            raise InputError(
                f"na={self.na}, nb={self.nb}, nf={self.nf}: the models of {output} have one "
                "coefficient less of each; give orders >= 2"
            )
        return replace(self, na=na, nb=nb, nf=nf, integrator=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssessedFit:
    """An estimated model, its validation residuals, and its deviation from a physical model."""

    comparison: Comparison
    """Comparison of the model with the validation data."""
    tests: ResidualTest
    """Tests of the model's residuals on the validation data."""
    deviation: Vector | None
    """|G - G_physics| / |G_physics| at the study's frequencies, (n,); None without a reference."""
    together: ResidualTest | None = None
    """Tests of the residuals of all outputs of the model; None if the model has one output."""

    @property
    def name(self) -> str:
        """Name of the model in the report: ARX or OE."""
        return self.comparison.name

    @property
    def model(self) -> Fit:
        """The model."""
        return self.comparison.model


def input_word(input: Input) -> str:
    """Return the name of an input in sentences."""
    return "voltage" if input.name == "u" and not input.is_scaled else input.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """Data, models and statistics of a report."""

    recordings: tuple[Recording, ...]
    """Given recordings, in their order."""
    estimation: Dataset
    """Data that the models were estimated from: u in V."""
    validation: Dataset
    """Data with which the models are compared, in the same units."""
    halves: bool
    """True if estimation and validation data are the first and the second half of one recording."""
    estimated: tuple[AssessedFit, ...]
    """Models that were estimated from the estimation data."""
    reference: Comparison | None
    """Comparison of the physical model of the arm; None for another rig, or a held arm."""
    note: str
    """Text that names the quantities that the comparisons estimated from the validation data."""
    omega: Vector
    """Frequencies at which the models are compared with the physical model, in rad/s, (n,)."""
    doubt: str = ""
    """Reason why the data show no orders; "" if they do."""
    others: tuple[Study, ...] = ()
    """Studies of the other outputs of the same models and recordings."""

    @property
    def output(self) -> str:
        """Name of the output."""
        return self.estimation.output

    @property
    def angle(self) -> str:
        """Name of the output in a sentence."""
        return OUTPUTS.get(self.output, self.output)

    @property
    def symbol(self) -> str:
        """Symbol of the output."""
        return symbol(self.output)

    @property
    def integrates(self) -> bool:
        """True if the output is a ramp at a constant voltage."""
        return self.output in INTEGRATING_OUTPUTS

    @property
    def input(self) -> str:
        """Name of the input for people: "voltage", or the name in the rig's description."""
        return input_word(self.recordings[0].description.input)

    @property
    def of_arm(self) -> bool:
        """True if the recordings are of the arm."""
        return bool(self.recordings[0].description.arm)

    @property
    def models(self) -> tuple[Comparison, ...]:
        """Comparisons of the estimated models, then of a physical model."""
        estimated = tuple(m.comparison for m in self.estimated)
        return estimated if self.reference is None else (*estimated, self.reference)

    @property
    def best(self) -> AssessedFit:
        """The estimated model that simulates the validation data best."""
        return self.ranked[0]

    @property
    def ranked(self) -> tuple[AssessedFit, ...]:
        """The estimated models, sorted by rms error, the best first."""
        return tuple(sorted(self.estimated, key=lambda m: m.comparison.rms_error))

    def recording_of(self, sha256: str) -> Recording:
        """Return the recording with this hash."""
        return next(r for r in self.recordings if r.sha256 == sha256)


def best_first(study: Study) -> Study:
    """Return the study with its models in the order of `ranked`: the first line is widest."""
    order = [m.name for m in study.ranked]
    first, *others = (
        replace(part, estimated=tuple(sorted(part.estimated, key=lambda m: order.index(m.name))))
        for part in each_output(study)
    )
    return replace(first, others=tuple(others))


def each_output(study: Study) -> tuple[Study, ...]:
    """Return the study of each output."""
    return (study, *study.others)


def study(
    recordings: Sequence[Recording],
    *,
    orders: Orders | None = None,
    treat: Callable[[Any], Any] | None = None,
    outputs: Sequence[str] = (),
) -> Study:
    """Estimate ARX and OE models, and compare them and the physical model with validation data.

    If the deflection is constant, the arm was removed or held, and there is no physical model.
    There is none for another rig either: ARMAX replaces ARX, and the level of y at u = 0 is
    estimated. Default orders are then those of `structure_hints`.

    Steps and staircases are used neither for estimation nor for validation. Of the other
    recordings, the first is used for estimation, and the second for validation. A single other
    recording is split: its first half is for estimation, and its second half for validation.

    Parameters
    ----------
    recordings : sequence of Recording
        At least one recording that is neither a step nor a staircase.
    orders : Orders, optional
        Orders of the models; by default the orders of the arm.
    treat : callable, optional
        Treatment of the data of each recording before the estimation, such as `armrig.hampel`.
        The report prints every step of the treatment.
    outputs : sequence of str, optional
        Outputs of the models; default: the first channel. If two outputs are given, each model has
        both outputs, and the OE model has one denominator for both outputs.

    Returns
    -------
    Study
        Models, their comparison and their residual tests. `Study.others` contains the results for
        the second output.

    Raises
    ------
    ValueError
        There are no data to estimate from, the orders are too high for the data, or an output does
        not exist, or is a rate.
    """
    excited = [r for r in recordings if r.manifest.kind not in NO_MODEL]
    if not excited:
        raise FileError(
            "nothing to identify from: give a recording whose input is not a single step, such as "
            "a recording of `armrig collect blackbox`"
        )
    outputs, channels = outputs or (excited[0].first,), [*excited[0].channels]
    if len({*outputs} & {*channels}) < len(outputs):
        raise InputError(
            f"{', '.join(outputs)}: the models of a report have the output {' or '.join(channels)}"
            f"{', or both' * (len(channels) > 1)}; `armrig identify` takes the others"
        )
    several, of_arm = len(outputs) > 1, bool(excited[0].description.arm)
    read = [r.signals(outputs) if several else r.dataset(outputs[0]) for r in excited[:2]]
    data: list[Any] = [*read] if treat is None else [treat(dataset) for dataset in read]
    if several and not of_arm:
        data = [detrend(dataset) for dataset in data]
    estimation, validation = data if len(data) > 1 else data[0].split(2)
    by_output = _by_output(estimation)
    orders, doubt = orders or Orders(), ""
    if not of_arm:  # the arm integrates; the data show whether another rig does
        try:
            defaults = _suggest_orders(by_output)
        except InputError as err:
            ramp = any(integration(dataset, None).integrates for dataset in by_output)
            defaults = Orders(na=2, nb=2, nf=2, integrator=ramp)
            doubt = f"The data do not show the orders: {err}. The models have two poles."
        orders = defaults if orders == Orders() else replace(orders, integrator=defaults.integrator)
    for dataset in by_output:
        order = orders.of(dataset.output)
        samples = dataset.N - dataset.missing
        size: dict[str, Any] = {"samples": samples, "nk": order.nk, "nb": order.nb}
        require_sensible(na=order.na, **size)
        require_sensible(**size, nf=order.nf, integrator=order.integrator)
    fits = _fits(estimation, orders, of_arm=of_arm)
    halves = len(excited) == 1
    return study_of_fits(recordings, estimation, validation, fits, halves=halves, doubt=doubt)


def study_of_fits(
    recordings: Sequence[Recording],
    estimation: Dataset | Signals,
    validation: Dataset | Signals,
    models: Mapping[str, Fit],
    *,
    halves: bool,
    doubt: str = "",
) -> Study:
    """Compare models of all outputs, and the physical model of the arm, with validation data.

    The keys are the names of the models in the report.
    """
    tests = dict[str, ResidualTest]()
    each = _by_output(estimation), _by_output(validation)
    fits = [models]
    if isinstance(estimation, Signals):
        tests = {name: residuals(fit, validation) for name, fit in models.items()}
        fits = [
            {name: replace(fit[data.output], digest=data.digest) for name, fit in models.items()}
            for data in each[0]
        ]
    shared: dict[str, Any] = {"recordings": tuple(recordings), "halves": halves, "doubt": doubt}
    excited = [r for r in recordings if r.manifest.kind not in NO_MODEL] or recordings
    has_arm = all(r.description.arm and second_moves(r) for r in excited[:2])
    physics = [physical_model(ArmParameters(), dataset) if has_arm else None for dataset in each[0]]
    first, *others = (
        Study(
            estimation=ours,
            validation=theirs,
            **shared,
            **assess_fits(channel_fits, reference, theirs, tests),
        )
        for channel_fits, reference, ours, theirs in zip(fits, physics, *each, strict=True)
    )
    return replace(first, others=tuple(others))


def _by_output(data: Dataset | Signals) -> list[Dataset]:
    """Return the data of each output."""
    return [data.dataset(name) for name in data.outputs] if isinstance(data, Signals) else [data]


def _suggest_orders(data: Sequence[Dataset]) -> Orders:
    """Return the orders of an OE model that the data of all outputs suggest."""
    hints = [structure_hints(dataset) for dataset in data]
    nb, nf = (max(getattr(hint, name) for hint in hints) for name in ("nb", "nf"))
    integrator = any(hint.integrator for hint in hints)
    form = hints[0].process if len(hints) == 1 else ""
    nk = min(hint.nk for hint in hints)
    return Orders(na=nf, nb=nb, nf=nf, nk=nk, integrator=integrator, form=form)


def _fits(data: Dataset | Signals, orders: Orders, *, of_arm: bool) -> dict[str, Fit]:
    """Return the models of all outputs, by their names in the report."""
    outputs = data.signals().outputs
    each = [orders.of(name) for name in outputs]
    first = each[0]
    how: dict[str, Any] = {"nb": [[order.nb] for order in each], "nk": orders.nk}
    if len(each) == 1 and not of_arm:  # the level of y at u = 0 need not be 0
        how |= {"integrator": first.integrator, "offset": not first.integrator}
        fits = {"ARMAX": armax(data, na=first.na, nc=first.na, **how)}
        fits["OE"] = oe(data, nf=first.nf, **how)
        if first.form:
            with suppress(InputError):  # such as a pole that is too fast for Ts
                fits[first.form] = process(data, first.form, offset=how["offset"])
        return fits
    # A is diagonal: each output depends on its own past only, as in the model of one output.
    fits = {"ARX": arx(data, na=np.diag([order.na for order in each]), **how)}
    if len(each) == 1:
        return fits | {"OE": oe(data, nf=first.nf, integrator=first.integrator, **how)}
    integrating = [name for name, order in zip(outputs, each, strict=True) if order.integrator]
    nf = orders.nf - bool(integrating)
    return fits | {"OE": oe(data, nf=nf, integrator=integrating, shared="denominator", **how)}


def assess_fits(
    fits: Mapping[str, Fit],
    physics: Fit | None,
    validation: Dataset,
    together: Mapping[str, ResidualTest] | None = None,
) -> dict[str, Any]:
    """Compare all models with the validation data; return fields of a `Study`.

    The keys are the names of the models in the report. `together` contains joint tests of all
    outputs, for the models that have several outputs.
    """
    # Compare first, because `compare` refuses a model of another sampling time.
    every = dict(fits) if physics is None else {**fits, physics.label: physics}
    table = compare(validation, *every.values(), labels=tuple(every))
    omega = np.geomspace(0.5, min(100.0, np.pi / validation.Ts), 200)
    G = None if physics is None else physics.frequency_response(omega).G
    estimated = tuple(
        AssessedFit(
            comparison=row,
            tests=residuals(fit, validation),
            deviation=None
            if G is None
            else np.abs(fit.frequency_response(omega).G - G) / np.abs(G),
            together=(together or {}).get(name),
        )
        for row, (name, fit) in zip(table.rows, fits.items(), strict=False)
    )
    return {
        "estimated": estimated,
        "reference": None if physics is None else table.rows[-1],
        "note": table.note,
        "omega": omega,
    }
