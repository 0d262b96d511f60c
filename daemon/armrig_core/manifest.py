"""What a recording says of how it came about: the MCAP metadata and attachments of a run."""

from __future__ import annotations

from typing import Any

import msgspec

from armrig_core.rehearsal import Rehearsal

RUN = "armrig.run"
"""Name of the metadata record written before the first sample."""
OUTCOME = "armrig.outcome"
"""Name of the metadata record written at the end; a recording without it was cut off."""
CONFIG, CALIBRATION, INPUT = "config.json", "calibration.json", "input.csv"
"""Names of the attachments; the input has one voltage a line, under the heading u_v."""
CALIBRATION_RAW = "calibration.csv.gz"
"""Name of the attachment with the samples that the calibration was estimated from."""


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """How a run was made; each field is one entry of the metadata, as JSON."""

    rig: str
    run_id: str
    experiment: str
    """Kind of experiment, such as blackbox."""
    details: dict[str, Any] = {}
    """What the experiment was made of, such as the seed of its input."""
    Ts: float
    """Sampling time, in s."""
    samples: int
    """Length of the input."""
    k_first: int = -1
    """Index of the first sample; -1 where the recording does not say."""
    part: int = 0
    """Number of the file among those of a long run, from 1; 0 where one file holds all of it."""
    part_k_first: int = -1
    """Index of the first sample that was due in this part; -1 for a run in one file."""
    pacing: str = "exchange"
    """Who made the samples: `scheduled`, the device's timer, or `exchange`, the host."""
    started: str
    """Wall-clock time of the start, ISO 8601 with the offset from UTC."""
    clock_offset_ns: int
    """Real-time clock less monotonic clock at the start: log times are t_host_ns plus this."""
    armrig: str
    """Version of armrig."""
    protocol: str
    """Version and schema hash of the wire."""
    device: dict[str, Any] = {}
    """What the device said of itself: uid, boot_id, firmware, adc_bits, pwm_bits, and so on."""
    host: dict[str, Any] = {}
    """Kernel, scheduling and locked memory of the loop, baud rate, port."""
    config_sha256: str = ""
    """Hash of the attached configuration."""
    calibration_sha256: str = ""
    """Hash of the attached calibration; empty in recordings of earlier releases."""
    rehearsal: Rehearsal | None = None
    """What the model of the rig did under the input before the run."""

    def metadata(self) -> dict[str, str]:
        """Return the fields as MCAP wants them: each a JSON text."""
        return {k: msgspec.json.encode(v).decode() for k, v in msgspec.structs.asdict(self).items()}


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How a run ended."""

    outcome: str
    """`complete`, or why it ended early; `continued` in a part that another one follows."""
    samples: int
    """Samples recorded, in this file."""
    missing: int
    """Samples that the gaps are short of, in this file."""

    def metadata(self) -> dict[str, str]:
        """Return the fields as MCAP wants them: each a JSON text."""
        return {k: msgspec.json.encode(v).decode() for k, v in msgspec.structs.asdict(self).items()}


def _fields(metadata: dict[str, str]) -> dict[str, Any]:
    return {key: msgspec.json.decode(text) for key, text in metadata.items()}


def manifest_of(metadata: dict[str, str]) -> Manifest:
    """Return the manifest in a metadata record named `RUN`.

    Raises
    ------
    msgspec.DecodeError
        An entry is missing, no JSON, or of another type.
    """
    return msgspec.convert(_fields(metadata), Manifest)


def outcome_of(metadata: dict[str, str]) -> Outcome:
    """Return the outcome in a metadata record named `OUTCOME`; raises as `manifest_of`."""
    return msgspec.convert(_fields(metadata), Outcome)
