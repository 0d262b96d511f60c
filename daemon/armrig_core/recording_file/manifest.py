"""The MCAP metadata and attachments that describe the run in a recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Self

import msgspec
from msgspec import UNSET, UnsetType

from armrig_core.commands.codes import OutcomeCode
from armrig_core.commands.commands import EVERY, Rehearsal
from armrig_core.errors import InputError
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.emulated import is_emulated

RUN = "armrig.run"
"""Name of the metadata record that is written before the first sample."""
OUTCOME = "armrig.outcome"
"""Name of the metadata record after the last sample; without this record, the file was cut off."""
RECOVERED = "armrig.recovered"
"""Name of the metadata record that a recovery adds to an unfinished file."""
CONFIG, CALIBRATION, INPUT = "config.json", "calibration.json", "input.csv"
"""Names of the attachments; the input has one voltage per line, under the heading u_v."""
REFERENCE, CONTROLLER = "reference.csv", "controller.json"
"""Names of the attachments of a run in control, in place of the input: the reference, with one
number per line under a heading, and the law."""
SOURCES = (INPUT, REFERENCE)
"""Names of the attachments that may have 80 MB."""
CALIBRATION_RAW = "calibration.csv.gz"
"""Name of the attachment with the samples from which the calibration was estimated."""

DESCRIPTION = "rig.toml"
"""Name of the attachment with the description of the rig."""

_DEPTH_LIMIT = 32
_INDEX_LIMIT = 1 << 62


class _MetadataRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of a metadata record."""

    def metadata(self) -> dict[str, str]:
        """Return the fields as MCAP needs them; each value is a JSON text."""
        fields = msgspec.structs.asdict(self)
        values = {key: value for key, value in fields.items() if value is not UNSET}
        return {key: msgspec.json.encode(value).decode() for key, value in values.items()}

    @classmethod
    def of(cls, metadata: dict[str, str]) -> Self:
        """Return the contents of a metadata record.

        Raises msgspec.DecodeError if an entry is missing, is not JSON, or has another type.
        """
        fields = {key: msgspec.json.decode(text) for key, text in metadata.items()}
        return msgspec.convert(fields, cls)


_MOST_EVERY = 12_000  # 60 s, in samples of 5 ms


class Manifest(_MetadataRecord, frozen=True, kw_only=True):
    """Description of a run; each field is one entry of the metadata, as JSON."""

    rig: str
    run_id: str
    experiment: str
    """Kind of experiment, and its name if a person chose one, such as blackbox-monday."""
    details: dict[str, Any] = {}
    """Parameters of the experiment, such as the seed of its input."""
    owner: str = ""
    """Owner of the rig: the name that the client gave, and the verified identity in round brackets.

    Example: `armrig collect (certificate alice)`.
    """
    owner_checked: str = ""
    """Verified identity of the owner, such as `certificate alice`; empty if none was verified."""
    Ts: float
    """Sampling time, in s."""
    samples: int
    """Length of the input, in samples."""
    k_first: int = -1
    """Index k of the first sample; -1 if the recording does not state this index."""
    part: int = 0
    """Number of the file among the parts of a long run, from 1; 0 if the run has one file."""
    part_k_first: int = -1
    """Index k of the first due sample of this part; -1 if the run has one file."""
    pacing: str = "exchange"
    """Source of the sampling instants: `scheduled`, the device's timer, or `exchange`, the host."""
    started: str
    """Wall-clock time of the start, ISO 8601 with the offset from UTC."""
    clock_offset_ns: int
    """Real-time clock minus monotonic clock at the start, in ns: log time = t_host_ns + offset."""
    armrig: str
    """Version of armrig."""
    protocol: str
    """Version and schema hash of the wire protocol."""
    device: dict[str, Any] = {}
    """Properties that the device reported, such as uid, boot_id, firmware, adc_bits, pwm_bits."""
    host: dict[str, Any] = {}
    """Kernel, scheduling and locked memory of the loop, baud rate, port."""
    config_sha256: str = ""
    """SHA-256 of the attached configuration; a hash is empty in a file of an older release."""
    calibration_sha256: str = ""
    """SHA-256 of the attached calibration."""
    description_sha256: str = ""
    """SHA-256 of the attached description of the rig."""
    calibration_raw_sha256: str = ""
    """SHA-256 of the attached samples of the calibration; empty without such samples."""
    input_sha256: str = ""
    """SHA-256 of the attached input or reference, which only the first part of a run contains."""
    controller_sha256: str | UnsetType = UNSET
    """SHA-256 of the attached law; absent for a run whose input was known before, and empty for a
    run whose client set each voltage."""
    rehearsal: Rehearsal | None = None
    """Response of the rig's model to the input, computed before the run."""

    @property
    def every(self) -> int:
        """Number of samples with each value of the input.

        A client makes a Ts that is too long for the device: it plays each value in `every` samples.
        The instants of this sampling time, `every` * `Ts`, are the first sample of each value.
        """
        every = self.details.get(EVERY, 1)
        return every if type(every) is int and 1 <= every <= _MOST_EVERY else 1

    @property
    def source(self) -> str:
        """Name of the attachment that determines the input: the input itself, or a reference."""
        return INPUT if self.controller_sha256 is UNSET else REFERENCE

    @property
    def attachment_hashes(self) -> dict[str, str]:
        """Recorded SHA-256 of the attachments of this file, by name, in hexadecimal digits."""
        hashes = {
            CONFIG: self.config_sha256,
            CALIBRATION: self.calibration_sha256,
            DESCRIPTION: self.description_sha256,
            CALIBRATION_RAW: self.calibration_raw_sha256,
            self.source: self.input_sha256 if self.part <= 1 else "",
            CONTROLLER: self.controller_sha256 or "",
        }
        return {name: sha256 for name, sha256 in hashes.items() if sha256}

    @property
    def due(self) -> range:
        """Indices of the due samples, from the first sample of this file to the end of the run."""
        if self.k_first < 0:
            return range(_INDEX_LIMIT)  # any index may belong to the run
        first = self.part_k_first if self.part > 1 else self.k_first
        return range(max(first, 0), min(self.k_first + self.samples, _INDEX_LIMIT))

    @property
    def kind(self) -> str:
        """Kind of experiment, such as blackbox, without the name that a person chose."""
        return self.experiment.partition("-")[0]

    @property
    def emulated(self) -> bool:
        """True if the identity of the device or the port belongs to an emulator."""
        return is_emulated(uid=str(self.device.get("uid", "")), port=str(self.host.get("port", "")))


class Outcome(_MetadataRecord, frozen=True, kw_only=True):
    """End of a run."""

    outcome: str
    """`complete`, or the reason of an early end; `continued` if another part follows."""
    samples: int
    """Number of samples in this file."""
    missing: int
    """Number of missing samples in the gaps of this file."""
    code: str = OutcomeCode.UNKNOWN
    """Outcome for programs, an `OutcomeCode`."""


class Recovered(_MetadataRecord, frozen=True, kw_only=True):
    """Completion of a file that its daemon left unfinished."""

    when: str
    """Wall-clock time of the recovery, ISO 8601 with the offset from UTC."""
    armrig: str
    """Version of armrig that recovered the file."""
    kept_bytes: int
    """Length of the undamaged beginning of the file, in B."""
    cut_off_bytes: int
    """Length of the damaged rest, which was cut off, in B."""
    damage: str
    """Omitted attachments, and reason why the rest is unreadable; empty for an undamaged file."""


def description_of(attachments: Mapping[str, bytes]) -> Description:
    """Return the description of the rig of a recording; without an attached one, the arm's.

    Raises FileError or InputError if the attached description is not allowed.
    """
    text = attachments.get(DESCRIPTION)
    return builtin("arm") if text is None else Description.of(text)


def check_whole_numbers(record: Manifest | Outcome | Recovered) -> None:
    """Raise ValueError if a whole number has more than 64 bit, or a value is nested too deeply.

    No time, index or count needs more than 64 bit. Python also reads a number of 400 digits, but
    cannot convert it to a float. armrig writes no deeply nested values; printing such a value would
    exceed the recursion limit.
    """
    for name in record.__struct_fields__:
        value = getattr(record, name)
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"{name} does not fit into 64 bit")
        depth, layer = 0, [value]
        while layer := [v for outer in layer for v in _within(outer)]:
            depth += 1
            if depth > _DEPTH_LIMIT:
                raise InputError(f"{name} is nested more than {_DEPTH_LIMIT} levels deep")


def _within(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()
