"""Poses of chassis and arm for Foxglove's 3D panel."""

from __future__ import annotations

from math import cos, isfinite, sin
from pathlib import Path
from typing import Any

from armrig_core.errors import InputError
from armrig_core.process.imports import load_extra
from armrig_core.telemetry.topics import topic

from armrig.recordings.recording import Recording

_ARM_HEIGHT_M = 0.1  # makes both frames visible; the real height is unknown
_NS = 1_000_000_000
_END_NS = 2**32 * _NS  # end of Foxglove's timestamps


def transforms_channel(rig: str, context: Any) -> Any:
    """Return the channel `/rig/<id>/transforms` of a foxglove-sdk context.

    Raises MissingPackageError if foxglove-sdk is not installed.
    """
    channels = load_extra("foxglove.channels", "foxglove")
    return channels.FrameTransformsChannel(topic(rig, "transforms"), context=context)


def transforms(theta_1: float, alpha: float, t_ns: int) -> Any:
    """Return the coordinate frames `chassis` (turned by θ₁ in `rig`) and `arm` (by α in `chassis`).

    Both frames turn about z, so that the arm's angle in `rig` is θ₁ + α. A frame is left out
    if its angle is not finite. `t_ns` is the time on the wall clock.
    """
    messages = load_extra("foxglove.messages", "foxglove")
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
    sdk = load_extra("foxglove", "foxglove")
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
