"""Recordings made by hand, as the daemon writes them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from io import BytesIO
from math import tau
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from armrig.recordings.recording import Channel, Recording
from armrig_core.commands.codes import GapCode, OutcomeCode
from armrig_core.recording_file.manifest import CALIBRATION, INPUT, OUTCOME, RUN, Manifest, Outcome
from armrig_core.rig.arm import ArmParameters, arm_matrices, zero_order_hold
from armrig_core.rig.calibration import Calibration, Potentiometer
from armrig_core.telemetry import protobuf, telemetry
from armrig_core.telemetry.topics import topic
from armrig_protocol.messages import Flag
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

OFFSET_NS = 1_750_000_000_000_000_000
TS = 0.01
POT = Calibration().theta_1


def with_channel(recording: Recording, name: str, y: Any = None, valid: Any = None) -> Recording:
    """Return the recording with other values, or another mask, of a channel."""
    own = recording.channels[name]
    changed = Channel(own.y if y is None else y, own.valid if valid is None else valid)
    return replace(recording, channels={**recording.channels, name: changed})


def manifest(**changes: Any) -> Manifest:
    """Return the manifest of a black-box run."""
    fields: dict[str, Any] = {
        "rig": "1",
        "run_id": "20261120T040000Z-0001",
        "experiment": "blackbox",
        "details": {"seed": 1, "a": 0.05},
        "Ts": TS,
        "samples": 10,
        "started": "2026-11-20T05:00:00+01:00",
        "clock_offset_ns": OFFSET_NS,
        "armrig": "0.1.0",
        "protocol": "1 f1591eb8",
        "device": {"firmware": "emulator", "adc_bits": 10, "pwm_bits": 10, "uid": "0001"},
        "host": {"kernel": "6.1.0", "scheduling": "SCHED_OTHER"},
    }
    return Manifest(**(fields | changes))


def sample(k: int, **changes: Any) -> telemetry.Sample:
    """Return sample k, 3 µs late, with the arm at rest in the middle of both tracks."""
    due = 1_000_000_000 + round(k * TS * 1e9)
    at_rest = telemetry.Sample(
        k=k,
        t_sched_ns=due,
        t_host_ns=due + 3_000,
        t_device_us=5_000 + round(k * TS * 1e6),
        value_0=POT.value(32768),
        value_1=0.0,
        u_cmd_v=1.0,
        u_applied_v=1.0,
        counts_0=32768,
        counts_1=32768,
        flags=int(Flag.RUN | Flag.ARMED),
    )
    return at_rest._replace(**changes)


def gap(k_first: int, count: int, u_held_v: float, reason: str = "link silent") -> Any:
    """Return a gap record."""
    return protobuf.message_class(protobuf.GAP)(
        k_first=k_first,
        count=count,
        t_from_ns=sample(k_first).t_sched_ns,
        t_to_ns=sample(k_first + count).t_sched_ns,
        u_held_v=u_held_v,
        reason=reason,
        code=next((code for code in GapCode if code.sentence == reason), GapCode.UNKNOWN),
    )


def event(k: int, message: str, level: str = "info") -> Any:
    """Return an event at sample k."""
    log = protobuf.message_class(protobuf.LOG)(level=protobuf.LEVELS[level], message=message)
    log.timestamp.FromNanoseconds(sample(k).t_host_ns + OFFSET_NS)
    return log


def note(k: int, text: str, owner: str = "Ada") -> Any:
    """Return a note that came at sample k."""
    log = event(k, text)
    log.name, log.owner, log.t_host_ns = protobuf.NOTE, owner, sample(k).t_host_ns
    return log


def timing(k: int) -> Any:
    """Return a timing report at sample k."""
    report = protobuf.message_class(protobuf.TIMING)(t_host_ns=sample(k).t_host_ns)
    report.wake_lateness_us.p50 = 3.0
    report.wake_lateness_us.n = 100
    return report


def _code_of(outcome: str) -> OutcomeCode:
    """Return the code that belongs to the sentence of an outcome."""
    codes = (OutcomeCode.COMPLETE, OutcomeCode.CONTINUED, OutcomeCode.STOPPED, OutcomeCode.DISARMED)
    return next((code for code in codes if outcome.startswith(code)), OutcomeCode.UNKNOWN)


def recorded(
    messages: Iterable[telemetry.Sample | bytes | Any],
    *,
    manifest: Manifest | None = None,
    calibration: Calibration | None = Calibration(),  # noqa: B008 - frozen
    outcome: Outcome | None = Outcome(outcome="complete", samples=0, missing=0),  # noqa: B008
    chunk_size: int = 128 << 10,
    compression: CompressionType = CompressionType.ZSTD,
    flush_every: int = 0,
    outcome_first: bool = False,
    u: Iterable[float] | None = None,
) -> bytes:
    """Return a recording of these messages: samples, protobuf messages, or bytes as samples.

    The manifest contains the hashes of the attachments, unless it has others. The outcome follows
    the messages, or precedes them as in a rewritten file.
    """
    manifest = manifest or globals()["manifest"]()
    text = msgspec.json.encode(calibration) if calibration else b""
    lines = b"" if u is None else "".join(["u_v\n", *(f"{volts!r}\n" for volts in u)]).encode()
    hashes = {"calibration_sha256": text, "input_sha256": lines}
    manifest = msgspec.structs.replace(
        manifest,
        **{
            name: getattr(manifest, name) or hashlib.sha256(data).hexdigest()
            for name, data in hashes.items()
            if data
        },
    )
    out = BytesIO()
    writer = Writer(out, chunk_size=chunk_size, compression=compression, enable_data_crcs=True)
    writer.start(profile="", library="armrig tests")
    writer.add_metadata(RUN, manifest.metadata())
    if text:
        writer.add_attachment(0, 0, CALIBRATION, "application/json", text)
    if lines:
        writer.add_attachment(0, 0, INPUT, "text/csv", lines)
    channels = {}
    kinds = {"sample": protobuf.SAMPLE, "gap": protobuf.GAP, "event": protobuf.LOG}
    for stream, name in {
        **kinds,
        "timing": protobuf.TIMING,
        "clock": protobuf.CLOCK,
        "state": protobuf.STATE,
    }.items():
        schema = writer.register_schema(name, "protobuf", protobuf.descriptor_set(name))
        channels[name] = writer.register_channel(topic(manifest.rig, stream), "protobuf", schema)
    if outcome and outcome.code == OutcomeCode.UNKNOWN:
        outcome = msgspec.structs.replace(outcome, code=_code_of(outcome.outcome))
    if outcome and outcome_first:
        writer.add_metadata(OUTCOME, outcome.metadata())
    log_time = publish_time = OFFSET_NS + sample(0).t_sched_ns  # they never go back in a file
    for i, message in enumerate(messages):
        if isinstance(message, telemetry.Sample):
            log_time = message.t_host_ns + OFFSET_NS
            publish_time = message.t_sched_ns + OFFSET_NS
            data, channel, k = (
                telemetry.encode_sample(message),
                channels[protobuf.SAMPLE],
                message.k,
            )
        elif isinstance(message, bytes):
            data, channel, k = message, channels[protobuf.SAMPLE], 0
        else:
            channel, k = channels[message.DESCRIPTOR.full_name], 0
            data = message.SerializeToString()
        writer.add_message(channel, log_time, data, publish_time, k & 0xFFFFFFFF)
        if flush_every and (i + 1) % flush_every == 0:
            writer.flush()
    if outcome and not outcome_first:
        writer.add_metadata(OUTCOME, outcome.metadata())
    writer.finish()
    return out.getvalue()


def written(directory: Path, data: bytes, name: str = "run.mcap") -> Path:
    """Return the path of a file that holds `data`."""
    path = directory / name
    path.write_bytes(data)
    return path


def turning(counts: Sequence[int]) -> list[telemetry.Sample]:
    """Return samples whose theta_1 reads `counts`, the rails flagged as the device does."""
    samples = []
    for k, reading in enumerate(counts):
        rail = not 64 <= reading < 65536 - 64
        flags = int(Flag.RUN | (Flag.ADC0_RAIL if rail else 0))
        angle = float("nan") if rail else POT.value(reading)
        samples.append(sample(k, counts_0=reading, value_0=angle, flags=flags))
    return samples


def of_the_arm(
    u: NDArray[np.float64],
    *,
    experiment: str = "blackbox",
    seed: int = 1,
    missing: slice | None = None,
    start: float = 0.0,
    rig: str = "1",
) -> bytes:
    """Return a recording of the handout's arm driven by `u`: 10-bit readings, dead band, jitter.

    From rest at theta_1 = `start`.
    """
    rng = np.random.default_rng(seed)
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, TS)
    x = np.array([start, 0.0, 0.0, 0.0])
    messages: list[Any] = []
    lost = range(*missing.indices(u.size)) if missing else range(0)
    for k, volts in enumerate(u):
        theta_1, alpha = (float(v) for v in C @ x)
        counts = _reading(theta_1, CALIBRATED.theta_1, rng), _reading(alpha, CALIBRATED.alpha, rng)
        late = int(3_000 + 20_000 * rng.exponential())
        [plain] = turning([counts[0]])
        due = sample(k).t_sched_ns
        if k in lost:
            messages += [gap(k, len(lost), float(u[k - 1]))] if k == lost.start else []
        else:
            messages.append(
                plain._replace(
                    k=k,
                    t_sched_ns=due,
                    t_host_ns=due + late,
                    t_device_us=5_000 + round(k * TS * 1e6) + late // 1000,
                    value_1=CALIBRATED.alpha.value(counts[1]),
                    counts_1=counts[1],
                    u_cmd_v=float(volts),
                    u_applied_v=float(volts),
                )
            )
        x = Phi @ x + Gamma[:, 0] * volts
    details = {"seed": seed, "a": 0.05}
    about = manifest(rig=rig, experiment=experiment, samples=u.size, details=details)
    ended = Outcome(outcome="complete", samples=u.size - len(lost), missing=len(lost))
    return recorded(messages, manifest=about, outcome=ended)


CALIBRATED = Calibration()


def _reading(angle: float, pot: Potentiometer, rng: np.random.Generator) -> int:
    """Return the reading of a 10-bit converter, left-justified; 0 in the dead band."""
    at = angle / pot.rad_per_count + pot.zero_counts
    if pot.wraps:
        at %= tau / pot.rad_per_count
        if at > 65536:
            return 0
    return min(max(round((at + 32 * rng.standard_normal()) / 64), 0), 1023) * 64
