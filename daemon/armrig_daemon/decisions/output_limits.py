"""Limits on measured outputs: an output outside its range, or unknown for too long, is a fault."""

from __future__ import annotations

from math import inf, isinf, isnan, nan

from armrig_core.process.printable import plural
from armrig_core.rig.channels import HALF_COUNTS
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag
from msgspec import UnsetType
from msgspec.structs import replace

from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Step, Trip
from armrig_daemon.decisions.state import DecisionState, OutputLimit, OutputWatch, Phase

_DRIVING = (Phase.ARMED, Phase.ACTIVE)
_RAILS = int(Flag.ADC0_RAIL), int(Flag.ADC1_RAIL)  # int: `&` of two Flags takes 0.5 µs


def observe(state: DecisionState, limits: tuple[OutputLimit, ...], sample: Sample) -> Step:
    """Count the samples outside the limits; trip if a driven rig has had too many in a row.

    A valid sample inside the limits begins the count again. An invalid sample and a missing sample
    do not, because neither shows that the output has come back.
    """
    watch = state.watch
    watched = tuple(
        _next_watch(watch[i] if watch else None, limit, sample) for i, limit in enumerate(limits)
    )
    state = replace(state, watch=watched)
    fault = outside(limits, watched) if state.phase in _DRIVING else None
    return state, [] if fault is None else [Trip(fault)]


def _next_watch(before: OutputWatch | None, limit: OutputLimit, sample: Sample) -> OutputWatch:
    """Return what is known of an output after a sample."""
    value, t_ns = (sample.value_1 if limit.channel else sample.value_0), sample.t_host_ns
    at_rail = 0
    if sample.flags & _RAILS[limit.channel]:
        counts = sample.counts_1 if limit.channel else sample.counts_0
        if side := limit.sides_of_rails[counts >= HALF_COUNTS]:
            value = inf if side == "above" else -inf
        elif isnan(value):
            at_rail = min((before.at_rail if before else 0) + 1, limit.rail_samples)
    if isnan(value):
        # The blind time begins with the first sample.
        watch = before or OutputWatch(0, t_ns, value)
        return replace(watch, at_rail=at_rail) if at_rail != watch.at_rail else watch
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
    for limit, output in zip(limits, watch or (), strict=False):
        if output.outside >= limit.samples:
            side = _side(limit, output.value)
            end = limit.high if side == "above" else limit.low
            cause = f"{limit.name} = {output.value:.6g} {limit.unit} is {side} {end:g} {limit.unit}"
            if isinf(output.value):
                cause = (
                    f"{limit.name} reads the end of its range, which counts as {side} {end:g} "
                    f"{limit.unit}"
                )
            value = nan if isinf(output.value) else output.value
            return Fault(Id.OUTPUT, cause, output=limit.name, value=value)
        if limit.rail_samples and output.at_rail >= limit.rail_samples:
            cause = f"{limit.name} read an end of its range in {plural(output.at_rail, 'sample')}"
            return Fault(Id.OUTPUT, cause, output=limit.name, value=output.value)
    return None


def blind(
    limits: tuple[OutputLimit, ...],
    watch: tuple[OutputWatch, ...] | UnsetType,
    now_ns: int,
    ts_us: int,
) -> Fault | None:
    """Return the fault if no valid sample of an output came for longer than allowed, or None."""
    for limit, output in zip(limits, watch or (), strict=False):
        age_ns, most_ns = now_ns - output.valid_ns, limit.blind_after_ns(ts_us)
        if most_ns and age_ns > most_ns:
            cause = (
                f"{limit.name} has had no valid sample for {age_ns / 1e6:.0f} ms: "
                f"{most_ns / 1e6:g} ms are allowed"
            )
            return Fault(Id.BLIND, cause, output=limit.name, value=output.value)
    return None


def too_slow(limits: tuple[OutputLimit, ...], ts_us: int) -> str:
    """Return why the blind time of an output does not fit a sampling time; "" if all fit."""
    least_ns = max(50_000_000, 5_000 * ts_us)
    for limit in limits:
        if 0 < limit.blind_ns < least_ns and not limit.blind_grows:
            return (
                f"blind_s = {limit.blind_ns / 1e9:g} of {limit.name} is too short for "
                f"Ts = {ts_us / 1e6:g} s: at least {least_ns / 1e9:g} s"
            )
    return ""
