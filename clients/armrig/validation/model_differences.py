"""Differences between models, as a table and as sentences that name the causes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.telemetry.channels import ARM_OUTPUTS

from armrig.models.characteristics import DRAWS, SCALARS, ModelCharacteristics
from armrig.models.structure_table import row_of
from armrig.numerics.quantities import digits, minus, number, places, with_range, with_std
from armrig.physics.systems import CAUSES

if TYPE_CHECKING:
    from armrig.validation.comparison import Comparison

SURE = 2.58  # least significant difference, in standard deviations, at the level 1 %
_MIN_BETTER_RATIO = 2.0  # least ratio of rms errors at which a model is called better
_MAX_COMPARED_RATIO = 5.0  # largest ratio of rms errors at which characteristics are compared
_NAMES = {
    "gain": "steady gain",
    "resonance": "resonance [rad/s]",
    "antiresonance": "anti-resonance [rad/s]",
    "bandwidth": "bandwidth [rad/s]",
    "rise_time": "63 % time [s]",
    "equivalent_time": "equivalent time [s]",
    "slowest_time": "slowest pole [s]",
    "overshoot": "overshoot [%]",
}


def table(rows: Sequence[Comparison]) -> list[str]:
    """Return a table of the characteristics of all models, a column for each model.

    If the linearisation is poor, a 95 % range from draws of the parameters replaces the standard
    deviation.
    """
    figures = [row.characteristics for row in rows]
    unit = "rate, " if any(t.integrating for t in figures) else ""
    columns = [[f"{unit}±: one σ", *_NAMES.values()]]
    most = max(1, *(t.poles.size for t in figures))
    columns[0] += ["poles [1/s]", *[""] * (most - 1)]
    for row, t in zip(rows, figures, strict=True):
        cells = [_cell(t, name) for name in SCALARS]
        poles = [_pole(t, i) for i in range(t.poles.size)]
        columns.append([row.name, *cells, *poles, *[""] * (most - len(poles))])
    widths = [max(map(len, column)) for column in columns]
    lines = []
    for name, *cells in zip(*columns, strict=True):
        first = f"{name:{widths[0]}}"
        values = "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths[1:], strict=True))
        lines.append(f"  {first}  {values}".rstrip())
    return lines + _notes({row.name: t for row, t in zip(rows, figures, strict=True)})


def _notes(figures: Mapping[str, ModelCharacteristics]) -> list[str]:
    """Return the meaning of a star in the table, and the number of rejected draws."""
    marked = {name: t for name, t in figures.items() if t.draws is not None and _poor(t)}
    if not marked:
        return []
    models = " and ".join(marked)
    lines = [f"  * linearisation poor ({models}): 95 % of {DRAWS} draws of the parameters"]
    if any((t.poles_sampled & (t.poles_std > 0)).any() for t in marked.values()):
        lines.append("    the σ of a pole cannot be trusted: fit.summary() prints its range")
    lines += [
        f"    {name}: {t.draws.left_out}, left out"
        for name, t in marked.items()
        if t.draws is not None and t.draws.left_out
    ]
    return lines


def _poor(t: ModelCharacteristics) -> bool:
    figures = any(_by_draws(t, name) for name in SCALARS)
    return figures or bool((t.poles_sampled & (t.poles_std > 0)).any())


def _by_draws(t: ModelCharacteristics, name: str) -> bool:
    return t.ranges[name].method == "sampled" and bool(np.isfinite(t.ranges[name].low))


def _cell(t: ModelCharacteristics, name: str) -> str:
    value, band = getattr(t, name), t.ranges[name]
    if not _by_draws(t, name):
        return _figure(value, t.std[name])
    return minus(with_range(value, float(band.low), float(band.high))) + "*"


def explanation(rows: Sequence[Comparison], *, brief: bool = False) -> list[str]:
    """Return sentences on the best model, and on each model's differences from the reference.

    The reference is the physical model, because its parameters were not estimated from data. If
    there is no physical model, the reference is the last model. Brief sentences contain no causes.
    """
    lines = [_best(rows)]
    reference = next((row for row in rows if not row.channel.quality), rows[-1])
    figures = reference.characteristics
    for row in (row for row in rows if row is not reference):
        if row.rms_error > _MAX_COMPARED_RATIO * reference.rms_error:
            lines.append(_hopeless(row, reference, brief=brief))
            continue
        apart = list(_apart(row, reference, figures, brief=brief))
        if not apart:
            lines.append(
                f"{row.name} and {reference.name}: no characteristic differs by more than its "
                f"uncertainty ({SURE:g} σ)."
            )
        lines += apart
    return lines


def _best(rows: Sequence[Comparison]) -> str:
    ranked = sorted(rows, key=lambda row: row.rms_error)
    best, next_ = ranked[0], ranked[min(1, len(ranked) - 1)]
    if len(rows) == 1:
        return f"{best.name} has an error of {digits(best.rms_error, 3)} rms."
    sizes = [digits(row.rms_error, 3) for row in (best, next_)]
    if sizes[0] == sizes[1]:
        text = f"{best.name} and {next_.name} are equally close to these data, {sizes[0]} rms"
    else:
        text = f"{best.name} is closest to these data, {sizes[0]} rms against {sizes[1]} of "
        text += next_.name
    if sizes[0] != sizes[1] and next_.rms_error < _MIN_BETTER_RATIO * best.rms_error:
        text += ": a small difference"
    if best.on_estimation_data:
        text += ", but it was estimated from these data: compare on another recording"
    return f"{text}."


def _hopeless(row: Comparison, reference: Comparison, *, brief: bool) -> str:
    """Return the reason why the characteristics of a poor model do not describe the rig."""
    text = f"{row.name} has {digits(row.rms_error / reference.rms_error, 3)} times the error of "
    text += f"{reference.name}: its characteristics differ because the model is poor"
    if brief:
        return f"{text}."
    if row_of(row.channel.structure).equation_error:
        return f"{text}. ARX assumes noise through 1/A; noise at the output biases it: take OE."
    return f"{text}. Look at its orders and its delay."


def _apart(
    row: Comparison, reference: Comparison, b: ModelCharacteristics, *, brief: bool
) -> Iterator[str]:
    """Yield a sentence for each characteristic that differs significantly from the reference b."""
    a, is_arm_output = row.characteristics, row.channel.output in ARM_OUTPUTS
    if a.integrating != b.integrating:
        which = (row if a.integrating else reference).name
        yield f"Only {which} integrates: the other characteristics cannot be compared."
        return
    for name in SCALARS:
        x, y = getattr(a, name), getattr(b, name)
        because = f"; {CAUSES[name]}" if is_arm_output and not brief else ""
        if np.isnan(x) != np.isnan(y):
            figure = _NAMES[name].partition(" [")[0]
            if np.isnan(y):
                has, none, at = row.name, reference.name, _figure(x, a.std[name])
            else:
                has, none, at = reference.name, row.name, _figure(y, b.std[name])
            yield f"{has} has a {figure} ({at}) and {none} has none{because.replace(';', ':', 1)}."
            continue
        std = float(np.hypot(a.std[name], b.std[name]))
        if np.isnan(x) or not abs(x - y) > max(SURE * std, 1e-3 * abs(y)):
            continue
        share = f" ({'+' * ((x - y) * y > 0)}{number(100 * (x - y) / y, 2)} %)" if y else ""
        figure = _NAMES[name].partition(" [")[0]
        yield (
            f"{figure}: {row.name} {_figure(x, a.std[name])}, {reference.name} "
            f"{_figure(y, b.std[name])}{share}{because}."
        )


def _figure(x: float, std: float) -> str:
    return "none" if np.isnan(x) else minus(with_std(x, std))


def _pole(t: ModelCharacteristics, i: int) -> str:
    s = t.poles[i]
    if np.isnan(s):
        return "none in continuous time"
    std = t.poles_std[i]
    decimals = places(std) if std > 0 else 2
    imaginary = f" {'+' if s.imag > 0 else '-'} {abs(s.imag):.{decimals}f}i" if s.imag else ""
    real = "0" if s == 0 else f"{s.real:.{decimals}f}"
    mark = "*" if t.poles_sampled[i] else ""
    return minus(real + imaginary) + (f" (±{std:.{decimals}f}){mark}" if std > 0 else "")
