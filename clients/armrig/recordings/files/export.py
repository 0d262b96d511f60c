"""Export of a recording to CSV, MATLAB, Parquet, pandas and xarray, always with the same columns.

Each sample that was due has a row. If the sample is missing, or shows no angle, the angle is NaN.
"""

from __future__ import annotations

from math import cos, isfinite, sin
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.errors import InputError
from armrig_core.process.imports import imported
from armrig_core.telemetry.channels import THETA_1, ChannelName
from armrig_core.telemetry.topics import topic
from numpy.typing import NDArray

from armrig.recordings.recording import Recording, export_columns, export_metadata

_BLOCK_ROWS = 65_536  # rows of a CSV file that are converted to text in one step
_ARM_HEIGHT_M = 0.1  # makes both frames visible; the real height is unknown
_NS = 1_000_000_000
_END_NS = 2**32 * _NS  # end of Foxglove's timestamps


def write_csv(recording: Recording, path: Path, *, raw: bool = False) -> None:
    """Write the columns as CSV, with their names in the first line; a missing value is nan.

    Numbers are written with all their digits. `armrig identify` reads the file.
    """
    found = export_columns(recording, raw=raw)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(found) + "\n")
        for begin in range(0, recording.N, _BLOCK_ROWS):
            some = [_texts(column[begin : begin + _BLOCK_ROWS]) for column in found.values()]
            file.writelines(",".join(row) + "\n" for row in zip(*some, strict=True))


def _texts(column: NDArray[Any]) -> list[str]:
    values = column.astype(np.uint8) if column.dtype == np.bool_ else column
    return [repr(value) for value in values.tolist()]


def write_mat(
    recording: Recording,
    path: Path,
    *,
    output: ChannelName = THETA_1,
    raw: bool = False,
) -> None:
    """Write a MAT-file of version 5 that contains u, y and Ts for iddata, and all columns.

    Use it in MATLAB with `load run.mat; z = iddata(y, u, Ts);`. Each column is (N, 1). y is the
    output, NaN where it is unknown. `sha256` is the hash of the recording.
    """
    from scipy.io import savemat

    found = export_columns(recording, raw=raw)
    # Octave and MATLAB compute with doubles and logical values only.
    kinds = {name: np.bool_ if c.dtype == np.bool_ else np.float64 for name, c in found.items()}
    variables: dict[str, Any] = {name: column.astype(kinds[name]) for name, column in found.items()}
    variables |= {"y": variables[output], "Ts": recording.Ts}
    about = {"sha256": recording.sha256, "output": output, "run_id": recording.manifest.run_id}
    with path.open("wb") as file:
        savemat(file, {**variables, **about}, oned_as="column", do_compression=True)


def write_parquet(recording: Recording, path: Path, *, raw: bool = False) -> None:
    """Write the columns as a Parquet file, with units, Ts, hash and run in its metadata.

    Raises ImportError if pyarrow is not installed.
    """
    pyarrow = imported("pyarrow", "parquet")
    parquet = imported("pyarrow.parquet", "parquet")
    table = pyarrow.table(export_columns(recording, raw=raw))
    parquet.write_table(table.replace_schema_metadata(export_metadata(recording)), str(path))


def transforms_channel(rig: str, context: Any) -> Any:
    """Return the channel `/rig/<id>/transforms` of a foxglove-sdk context.

    Raises MissingPackageError if foxglove-sdk is not installed.
    """
    channels = imported("foxglove.channels", "foxglove")
    return channels.FrameTransformsChannel(topic(rig, "transforms"), context=context)


def transforms(theta_1: float, alpha: float, t_ns: int) -> Any:
    """Return the coordinate frames `chassis` (turned by θ₁ in `rig`) and `arm` (by α in `chassis`).

    Both frames turn about z, so that the arm's angle in `rig` is θ₁ + α. A frame is left out
    if its angle is not finite. `t_ns` is the time on the wall clock.
    """
    messages = imported("foxglove.messages", "foxglove")
    stamp = messages.Timestamp(*divmod(t_ns, _NS))
    frames = (("rig", "chassis", theta_1, 0.0), ("chassis", "arm", alpha, _ARM_HEIGHT_M))
    return messages.FrameTransforms(
        transforms=[
            messages.FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=messages.Vector3(x=0.0, y=0.0, z=above),
                rotation=messages.Quaternion(x=0.0, y=0.0, z=sin(angle / 2), w=cos(angle / 2)),
            )
            for parent, child, angle, above in frames
            if isfinite(angle)
        ]
    )


def write_transforms(recording: Recording, path: Path) -> None:
    """Write the poses of chassis and arm as an MCAP file, at the times of the samples.

    The file does not contain the signals of the recording: open both files in the viewer.

    Raises ValueError if the wall clock of the rig's machine was before 1970 or after 2106.
    """
    sdk = imported("foxglove", "foxglove")
    context = sdk.Context()
    channel = transforms_channel(recording.manifest.rig, context)
    here = recording.present
    times = recording.samples["t_host_ns"] + recording.manifest.clock_offset_ns
    if not ((times >= 0) & (times < _END_NS)).all():
        msg = f"the wall clock of the rig's machine was at {times[0] / _NS:.0f} s after 1970; "
        raise InputError(f"{msg}--transforms needs times from 1970 to 2106: export a CSV instead")
    with sdk.open_mcap(path, allow_overwrite=True, context=context):
        for t_ns, theta_1, alpha in zip(
            times.tolist(),
            recording.theta_1[here].tolist(),
            recording.alpha[here].tolist(),
            strict=True,
        ):
            channel.log(transforms(theta_1, alpha, t_ns), log_time=t_ns)
