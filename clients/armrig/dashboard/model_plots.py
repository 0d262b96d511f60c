"""Curves of models, which the page draws: outputs, residuals, poles, responses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from armrig_core.errors import ArmrigError
from numpy.typing import NDArray

from armrig.dashboard.model_data import ModelData, validation_data
from armrig.dashboard.study_of_one import drawn as draw_points
from armrig.dashboard.workbench import ValidatedFit, Wanted, sha256_of, validate_model
from armrig.models.characteristics import integrates
from armrig.models.equation import gain_unit
from armrig.models.figures import continuous_phase, in_discrete_time, response_and_bands
from armrig.models.fit import Fit
from armrig.models.uncertainty import parameter_draws, pole_regions, step_band, zero_regions
from armrig.numerics.confidence_regions import Region
from armrig.numerics.whiteness import BAND_99_PERCENT
from armrig.plots.layout import decibels
from armrig.validation.comparison import compare

Kind = Literal["output", "residuals", "poles", "frequency", "step"]
MOST_AHEAD = 10_000
"""Largest prediction horizon, in samples."""
_DECIMALS = 8  # of a measured or simulated output
_FREQUENCIES = 500
_Models = Sequence[tuple[int, ValidatedFit]]
"""Models with their numbers in the page's list."""
_ChannelFits = Sequence[tuple[int, str, Fit]]
_Curve = dict[str, Any]
_KEPT = 512  # curves of models


def plot(
    folder: Path, data: ModelData, wanted: tuple[Wanted, ...], kind: Kind, horizon: int
) -> dict[str, Any]:
    """Return the panels of a plot; a note names the models that are missing, with the reasons."""
    models: list[tuple[int, ValidatedFit]] = []
    missing = []
    for k, one in enumerate(wanted):
        try:
            models.append((k, validate_model(folder, data, one)))
        except ArmrigError as err:
            missing.append(f"model {k + 1} is missing: {err}")
    other = validation_data(folder, data)
    panels = {
        "output": lambda: _outputs(models, other.columns, horizon),
        "residuals": lambda: _residuals(models),
        "poles": lambda: _of_channels(models, _poles),
        "frequency": lambda: _of_channels(models, _frequency),
        "step": lambda: _of_channels(models, _step),
    }
    files = dict.fromkeys([folder / data.file, folder / (data.validation or data.file)])
    return {
        "kind": kind,
        "panels": [*panels[kind]()] if models else [],
        "sha256": [*map(sha256_of, files)],
        "note": "; ".join(missing),
    }


def _outputs(models: _Models, other: Any, horizon: int) -> Iterator[_Curve]:
    columns = other.signals()
    tables = [(k, one.fit.label, _comparison(one, other, horizon)) for k, one in models]
    for i, output in enumerate(columns.outputs):
        measured = np.where(columns.valid[:, i], columns.y[:, i], np.nan)
        series = [_time_curve(None, "measured", columns.t, measured)]
        for k, name, rows in tables:
            series.append(_time_curve(k, name, columns.t, rows[i].y))
        yield _panel(output, ("t", "s"), (output, columns.units[i]), series)


def _comparison(model: ValidatedFit, other: Any, horizon: int) -> Any:
    known = {0: model.simulated, 1: model.predicted}
    return known.get(horizon) or compare(other, model.fit, horizon=horizon)


def _time_curve(model: int | None, name: str, t: Any, y: Any) -> _Curve:
    x, least, largest = draw_points(t, y, _DECIMALS)
    curve = {"model": model, "name": name, "x": x, "least": least, "largest": largest}
    return curve | {"style": "line"}


def _residuals(models: _Models) -> Iterator[_Curve]:
    first = models[0][1].tests
    ny, nu, lag = len(first.outputs), len(first.inputs), ("lag", "samples")
    for i, output in enumerate(first.outputs):
        series = []
        for k, one in models:
            r = one.tests.autocorrelation.reshape(ny, ny, -1)[i, i, 1:]
            series.append(_curve(one.tests.lags[1:], r, "stems", model=k, name=one.fit.label))
        width = float(np.atleast_1d(first.autocorrelation_band)[i])
        bands = [{"low": -width, "high": width, "name": "99 %"}]
        yield _panel(f"residuals of {output}", lag, ("r_e", ""), series, bands)
    for i, j in np.ndindex(ny, nu):
        series = []
        for k, one in models:
            r = one.tests.cross_correlation.reshape(ny, nu, -1)[i, j]
            edge = BAND_99_PERCENT * one.tests.cross_std.reshape(ny, nu, -1)[i, j]
            curve = _curve(one.tests.cross_lags, r, "stems", model=k, name=one.fit.label)
            series.append(curve | _edges(-edge, edge))
        title = f"{first.inputs[j]} and the residuals of {first.outputs[i]}"
        yield _panel(title, lag, ("r_eu", ""), series)


def _of_channels(models: _Models, panels: Any) -> Iterator[_Curve]:
    """Yield the panels of each pair of an input and an output."""
    first = models[0][1].fit
    for pair in np.ndindex(first.ny, first.nu):
        fits = [(k, one.fit.label, _channels(one.fit).get(pair)) for k, one in models]
        i, j = pair
        if any(fit for *_, fit in fits):
            title = f"{first.inputs[j]} to {first.outputs[i]}"
            yield from panels([one for one in fits if one[2] is not None], title)


@lru_cache(maxsize=_KEPT)
def _channels(fit: Fit) -> dict[tuple[int, ...], Fit]:
    """Return the sampled model of each pair of an output and an input."""
    return {(i, j): in_discrete_time((channel,))[0] for i, j, channel in fit.channels()}


def _poles(models: _ChannelFits, title: str) -> Iterator[_Curve]:
    angle = np.linspace(0, 2 * np.pi, 181)
    series = [_curve(np.cos(angle), np.sin(angle), "line", model=None, name="unit circle")]
    for k, name, fit in models:
        series += [curve | {"model": k, "name": name} for curve in _roots(fit)]
    yield _panel(title, ("Re z", ""), ("Im z", ""), series)


@lru_cache(maxsize=_KEPT)
def _roots(fit: Fit) -> list[_Curve]:
    draws, curves = parameter_draws(fit), []
    roots = {"cross": pole_regions(fit, draws), "ring": zero_regions(fit, draws)}
    for style, regions in roots.items():
        z = np.array([region.centre for region in regions], np.complex128)
        curves.append(_curve(z.real, z.imag, style))
        for region in regions:
            curves += _borders(region)
    return curves


def _borders(region: Region) -> Iterator[_Curve]:
    """Yield the 95 % region of a root: an interval, an ellipse, or the draws inside it."""
    if region.interval is not None and np.isfinite(region.interval).all():
        yield _curve(np.array(region.interval), np.zeros(2), "line")
    border = region.border()
    if border is not None and np.isfinite(border).all():
        yield _curve(border[0], border[1], "line")
    if region.densest is not None:
        inside = region.densest.inside()
        z = np.concatenate([inside, inside.conj()])
        yield _curve(z.real, z.imag, "points")


def _frequency(models: _ChannelFits, title: str) -> Iterator[_Curve]:
    highest = max(np.pi / fit.Ts for *_, fit in models)
    levels, phases = [], []
    for k, name, fit in models:
        level, phase = _response(fit, float(highest))
        levels.append(level | {"model": k, "name": name})
        phases.append(phase | {"model": k, "name": name})
    unit = f"dB re 1 {gain_unit([fit for *_, fit in models])}"
    yield _panel(title, ("ω", "rad/s"), ("|G|", unit), levels, log=True)
    yield _panel(title, ("ω", "rad/s"), ("arg G", "°"), phases, log=True)


@lru_cache(maxsize=_KEPT)
def _response(fit: Fit, highest: float) -> tuple[_Curve, _Curve]:
    """Return magnitude in dB and phase in degrees up to a frequency, with their 95 % bands."""
    omega = np.geomspace(highest / 600, highest, _FREQUENCIES)
    w, G, bands, _ = response_and_bands(fit, omega)
    level, phase = decibels(G), continuous_phase(G)
    of_level = of_phase = {}
    if bands is not None:
        low = np.maximum(bands[0].low, np.abs(G) * 1e-3)  # 0 has no decibels
        of_level = _edges(decibels(low), decibels(bands[0].high))
        edges = (np.clip(np.degrees(x), -180, 180) for x in (bands[1].low, bands[1].high))
        of_phase = _edges(*(phase + edge for edge in edges))
    return _curve(w, level, "line") | of_level, _curve(w, phase, "line") | of_phase


def _step(models: _ChannelFits, title: str) -> Iterator[_Curve]:
    fits = [fit for *_, fit in models]
    rate = all(map(integrates, fits))
    series = [_step_curve(fit, rate=rate) | {"model": k, "name": name} for k, name, fit in models]
    label = f"rate of {fits[0].output}" if rate else fits[0].output
    yield _panel(title, ("t", "s"), (label, gain_unit(fits, rate=rate)), series)


@lru_cache(maxsize=_KEPT)
def _step_curve(fit: Fit, *, rate: bool) -> _Curve:
    response = fit.step_response(max(50, round(1 / fit.Ts)), rate=rate)
    curve = _curve(np.append(0.0, response.t), np.append(0.0, response.y), "line")
    if not np.nan_to_num(response.std).any():
        return curve
    band = step_band(fit, response, parameter_draws(fit))
    return curve | _edges(np.append(0.0, band.low), np.append(0.0, band.high))


def _curve(x: Any, y: Any, style: str, **names: Any) -> _Curve:
    return {"x": _list(x), "y": _list(y), "style": style} | names


def _edges(low: Any, high: Any) -> _Curve:
    return {"low": _list(low), "high": _list(high)}


def _list(values: NDArray[Any]) -> list[float | None]:
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values.tolist()]


def _panel(
    title: str,
    x: tuple[str, str],
    y: tuple[str, str],
    series: list[_Curve],
    bands: Sequence[_Curve] = (),
    *,
    log: bool = False,
) -> _Curve:
    axes = {"x": {"label": x[0], "unit": x[1], "log": log}, "y": {"label": y[0], "unit": y[1]}}
    return {"title": title, **axes, "series": series, "bands": [*bands]}
