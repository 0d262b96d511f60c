"""What a recording says of how it came about: the MCAP metadata and attachments of a run."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from armrig_core import version_1
from armrig_core.emulated import is_emulated
from armrig_core.errors import InputError
from armrig_core.rehearsal import Rehearsal

RUN = "armrig.run"
"""Name of the metadata record written before the first sample."""
OUTCOME = "armrig.outcome"
"""Name of the metadata record written at the end; a recording without it was cut off."""
RECOVERED = "armrig.recovered"
"""Name of the metadata record that says that a daemon left the file unfinished."""
CONFIG, CALIBRATION, INPUT = "config.json", "calibration.json", "input.csv"
"""Names of the attachments; the input has one voltage a line, under the heading u_v."""
CALIBRATION_RAW = "calibration.csv.gz"
"""Name of the attachment with the samples that the calibration was estimated from."""

_DEPTH_LIMIT = 32
_LATEST = 1 << 62


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """How a run was made; each field is one entry of the metadata, as JSON."""

    rig: str
    run_id: str
    experiment: str
    """Kind of experiment, such as blackbox."""
    details: dict[str, Any] = {}
    """What the experiment was made of, such as the seed of its input."""
    owner: str = ""
    """Who had the rig: what he said of himself, and what was checked in round brackets, as in
    `armrig collect (certificate alice)`; empty in recordings of earlier releases."""
    owner_checked: str = ""
    """What the daemon had checked of him, such as `certificate alice`; empty for nothing, and in
    recordings of earlier releases."""
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

    @property
    def due(self) -> range:
        """Indices of the samples that are due from the file's first on, to the end of the run."""
        if self.k_first < 0:
            return range(_LATEST)  # any may be of it
        first = self.part_k_first if self.part > 1 else self.k_first
        return range(max(first, 0), min(self.k_first + self.samples, _LATEST))

    @property
    def emulated(self) -> bool:
        """Whether the rig was emulated: by its device's identity, or by a port of emulators."""
        return is_emulated(uid=str(self.device.get("uid", "")), port=str(self.host.get("port", "")))

    def metadata(self) -> dict[str, str]:
        """Return the fields as MCAP wants them: each a JSON text."""
        return _metadata(self)


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How a run ended."""

    outcome: str
    """`complete`, or why it ended early; `continued` in a part that another one follows."""
    samples: int
    """Samples recorded, in this file."""
    missing: int
    """Samples that the gaps are short of, in this file."""
    code: str = ""
    """How it ended, for programs: an `OutcomeCode`; `outcome_of` finds that of a file without."""

    def metadata(self) -> dict[str, str]:
        """Return the fields as MCAP wants them: each a JSON text."""
        return _metadata(self)


class Recovered(msgspec.Struct, frozen=True, kw_only=True):
    """How a file that its daemon left unfinished was completed."""

    when: str
    """Wall-clock time, ISO 8601 with the offset from UTC."""
    armrig: str
    """Version of armrig that did so."""
    kept_bytes: int
    """What was whole, from the beginning of the file on."""
    cut_off_bytes: int
    """What stood behind it."""
    damage: str
    """What was left out, and why the rest could not be read; empty for a file that was whole."""

    def metadata(self) -> dict[str, str]:
        """Return the fields as MCAP wants them: each a JSON text."""
        return _metadata(self)


def _metadata(record: Manifest | Outcome | Recovered) -> dict[str, str]:
    fields = msgspec.structs.asdict(record)
    if isinstance(record, Outcome) and not record.code:
        del fields["code"]
    return {key: msgspec.json.encode(value).decode() for key, value in fields.items()}


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
    found = msgspec.convert(_fields(metadata), Outcome)
    code = found.code or version_1.outcome_code(found.outcome)
    return msgspec.structs.replace(found, code=code)


def recovered_of(metadata: dict[str, str]) -> Recovered:
    """Return the recovery in a metadata record named `RECOVERED`; raises as `manifest_of`."""
    return msgspec.convert(_fields(metadata), Recovered)


def check_whole_numbers(record: Manifest | Outcome | Recovered) -> None:
    """Raise ValueError where a whole number needs more than 64 bit: no time, index or count does.

    Python reads 400 digits as gladly, and then fails wherever they meet a float. And where what
    is nested lies deeper than anything we write: whoever prints it would exceed the recursion.
    """
    for name in record.__struct_fields__:
        value = getattr(record, name)
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"{name} does not fit into 64 bit")
        depth, layer = 0, [value]
        while layer := [v for outer in layer for v in _within(outer)]:
            depth += 1
            if depth > _DEPTH_LIMIT:
                raise InputError(f"{name} is nested more than {_DEPTH_LIMIT} deep")


def _within(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()
