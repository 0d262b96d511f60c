"""Limits on measured outputs: an output outside its range, or unknown for too long, is a fault."""

from __future__ import annotations

from math import isnan

from armrig_core.telemetry.telemetry import Sample
from msgspec import UnsetType
from msgspec.structs import replace

from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Step, Trip
from armrig_daemon.decisions.state import OutputLimit, OutputWatch, Phase, State

_DRIVING = (Phase.ARMED, Phase.ACTIVE)


def observe(state: State, limits: tuple[OutputLimit, ...], sample: Sample) -> Step:
    """Count the samples outside the limits; trip if a driven rig has had too many in a row.

    A valid sample inside the limits begins the count again. An invalid sample and a missing sample
    do not, because neither shows that the output has come back.
    """
    values, watch = (sample.value_0, sample.value_1), state.watch
    watched = tuple(
        _watched(watch[i] if watch else None, limit, values[limit.channel], sample.t_host_ns)
        for i, limit in enumerate(limits)
    )
    state = replace(state, watch=watched)
    fault = outside(limits, watched) if state.phase in _DRIVING else None
    return state, [] if fault is None else [Trip(fault)]


def _watched(
    before: OutputWatch | None, limit: OutputLimit, value: float, t_ns: int
) -> OutputWatch:
    """Return what is known of an output after a sample that was requested at `t_ns`."""
    if isnan(value):
        return before or OutputWatch(0, t_ns, value)  # the blind time begins with the first sample
    if not _side(limit, value):
        return OutputWatch(0, t_ns, value)
    count = before.outside if before else 0
    return OutputWatch(min(count + 1, limit.samples), t_ns, value)


def _side(limit: OutputLimit, value: float) -> str:
    """Return on which side of its limits a value is; "" inside."""
    if limit.high is not None and value > limit.high:
        return "above"
    return "below" if limit.low is not None and value < limit.low else ""


def outside(
    limits: tuple[OutputLimit, ...], watch: tuple[OutputWatch, ...] | UnsetType
) -> Fault | None:
    """Return the fault if an output was outside its limits in too many samples, or None."""
    for limit, known in zip(limits, watch or (), strict=False):
        if known.outside >= limit.samples:
            side = _side(limit, known.value)
            end = limit.high if side == "above" else limit.low
            cause = f"{limit.name} = {known.value:.6g} {limit.unit} is {side} {end:g} {limit.unit}"
            return Fault(Id.OUTPUT, cause, output=limit.name, value=known.value)
    return None


def blind(
    limits: tuple[OutputLimit, ...], watch: tuple[OutputWatch, ...] | UnsetType, now_ns: int
) -> Fault | None:
    """Return the fault if no valid sample of an output came for longer than allowed, or None."""
    for limit, known in zip(limits, watch or (), strict=False):
        age_ns = now_ns - known.valid_ns
        if limit.blind_ns and age_ns > limit.blind_ns:
            cause = (
                f"{limit.name} has had no valid sample for {age_ns / 1e6:.0f} ms: "
                f"{limit.blind_ns / 1e6:g} ms are allowed"
            )
            return Fault(Id.BLIND, cause, output=limit.name, value=known.value)
    return None


def too_slow(limits: tuple[OutputLimit, ...], ts_us: int) -> str:
    """Return why the blind time of an output does not fit a sampling time; "" if all fit."""
    least_ns = max(50_000_000, 5_000 * ts_us)
    for limit in limits:
        if 0 < limit.blind_ns < least_ns:
            return (
                f"blind_s = {limit.blind_ns / 1e9:g} of {limit.name} is too short for "
                f"Ts = {ts_us / 1e6:g} s: at least {least_ns / 1e9:g} s"
            )
    return ""
