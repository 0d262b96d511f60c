"""Conversion of a device's sample to the units of the telemetry."""

from __future__ import annotations

from math import nan

from armrig_core.rig.calibration import Calibration
from armrig_core.rig.volts import volts_of
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag
from armrig_protocol.messages import Sample as DeviceSample

_ADC0_RAIL, _ADC1_RAIL = int(Flag.ADC0_RAIL), int(Flag.ADC1_RAIL)


def extended(last: int, raw: int) -> int:
    """Return the reading `raw` of a 32-bit clock without wraps; `last` is the previous result."""
    return last + ((raw - last) & 0xFFFFFFFF)


def is_older(last: int, raw: int) -> bool:
    """Return whether the reading `raw` of a 32-bit clock precedes `last` by at most half a wrap."""
    return (raw - last) & 0xFFFFFFFF > 0x7FFFFFFF


def converted(
    calibration: Calibration,
    m: DeviceSample,
    k: int,
    sched_ns: int,
    host_ns: int,
    device_us: int,
    code: int,
) -> Sample:
    """Return a sample in ns, V and rad, with its raw counts; an angle at a rail is NaN."""
    return Sample(
        k,
        sched_ns,
        host_ns,
        device_us,
        nan if m.flags & _ADC0_RAIL else calibration.theta_1.angle(m.y0),
        nan if m.flags & _ADC1_RAIL else calibration.alpha.angle(m.y1),
        volts_of(code),
        volts_of(m.u_k),
        m.y0,
        m.y1,
        m.flags,
    )
