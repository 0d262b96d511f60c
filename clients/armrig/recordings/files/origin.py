"""Origin of a recording: its rig, device, description and calibration."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Self

import msgspec
from armrig_core.commands.commands import StatusReport
from armrig_core.errors import FileError
from armrig_core.recording_file.manifest import CALIBRATION, Manifest, description_of
from armrig_core.rig.calibration import Calibration, Conversion
from armrig_core.rig.description import Description, builtin

from armrig.recordings.files.loading import beginning
from armrig.recordings.files.recording_summary import RecordingSummary


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Rig and calibration of a recording or of a live rig; a field with None matches any value."""

    rig: str
    """Id of the rig."""
    device: str | None = None
    """Unique id of the device; "" if it has none."""
    description_sha256: str | None = None
    """Hash of the rig's description."""
    calibration_sha256: str | None = None
    """Hash of the calibration."""
    path: Path | None = None
    """Recording to which the calibration is attached; None for a live rig."""

    @classmethod
    def of_run(cls, path: Path, manifest: Manifest) -> Self:
        """Return the origin of a recording."""
        return cls(
            rig=manifest.rig,
            device=str(manifest.device.get("uid", "")),
            description_sha256=_description_hash(manifest.description_sha256),
            calibration_sha256=manifest.calibration_sha256,
            path=path,
        )

    @classmethod
    def of_summary(cls, summary: RecordingSummary) -> Self:
        """Return the origin of a complete recording."""
        return cls(
            rig=summary.rig,
            device=summary.device,
            description_sha256=_description_hash(summary.description_sha256),
            calibration_sha256=summary.calibration_sha256,
            path=summary.path,
        )

    @classmethod
    def of_status(cls, report: StatusReport) -> Self:
        """Return the origin of the recordings that a live rig makes now."""
        return cls(
            rig=report.rig,
            device=str(report.device.get("uid", "")) if report.device else None,
            description_sha256=report.described.sha256,
            calibration_sha256=report.calibration_sha256,
        )

    def with_calibration(self, sha256: str) -> Self:
        """Return the origin of later recordings, which have another calibration."""
        return replace(self, calibration_sha256=sha256, path=None)

    def matches(self, summary: RecordingSummary) -> bool:
        """Return True if a recording is of this rig, device, description and calibration."""
        other = type(self).of_summary(summary)
        pairs = (
            (self.rig, other.rig),
            (self.device, other.device),
            (self.description_sha256, other.description_sha256),
        )
        if not all(wanted is None or wanted == has for wanted, has in pairs):
            return False
        if self.calibration_sha256 in (None, other.calibration_sha256):
            return True
        # A calibration names its file: the same values from another path have another hash.
        values = self.path and conversion_of(self.path)
        return values is not None and values == conversion_of(summary.path)


def _description_hash(sha256: str) -> str:
    """Return the hash of a description; recordings without a hash are of the arm."""
    return sha256 or builtin("arm").sha256


@lru_cache(maxsize=1000)
def conversion_of(path: Path) -> Conversion | None:
    """Return the attached conversion of counts to angles; None if it cannot be read."""
    with suppress(FileError, OSError, msgspec.MsgspecError, ValueError):
        if text := beginning(path)[1].attachments.get(CALIBRATION):
            return msgspec.json.decode(text, type=Calibration).conversion
    return None


@lru_cache(maxsize=1000)
def description_in(path: Path) -> Description | None:
    """Return the attached description of the rig; None if it cannot be read."""
    with suppress(FileError, OSError, ValueError):
        return description_of(beginning(path)[1].attachments)
    return None
