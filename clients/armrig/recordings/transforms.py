"""Chassis and arm as frames of a 3D panel: `foxglove.FrameTransforms`, made by foxglove-sdk."""

from __future__ import annotations

from math import cos, isfinite, sin
from typing import TYPE_CHECKING, Any

from armrig_core.errors import InputError
from armrig_core.topics import topic

from armrig.recordings.export import imported

if TYPE_CHECKING:
    from pathlib import Path

    from armrig.recordings.recording import Recording

_ARM_ABOVE_M = 0.1  # so that both frames are seen; the rig's own height is not known
_NS = 1_000_000_000
_END_NS = 2**32 * _NS  # of Foxglove's timestamps


def transforms_channel(rig: str, context: Any) -> Any:
    """Return the channel `/rig/<id>/transforms` of a foxglove-sdk context.

    Raises
    ------
    MissingPackageError
        foxglove-sdk is not installed.
    """
    channels = imported("foxglove.channels", "foxglove")
    return channels.FrameTransformsChannel(topic(rig, "transforms"), context=context)


def transforms(theta_1: float, alpha: float, t_ns: int) -> Any:
    """Return the frames of a sample: `chassis` turned by θ₁ in `rig`, `arm` by α in `chassis`.

    Both turn about z, so that the arm's angle in `rig` is θ₁ + α. A frame whose angle is not
    finite is left out. `t_ns` is the time on the wall clock.
    """
    messages = imported("foxglove.messages", "foxglove")
    stamp = messages.Timestamp(*divmod(t_ns, _NS))
    frames = (("rig", "chassis", theta_1, 0.0), ("chassis", "arm", alpha, _ARM_ABOVE_M))
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
    """Write the frames of each sample as an MCAP file, at the times of the recording's own.

    A viewer opens it together with the recording, from which nothing is repeated.

    Raises
    ------
    ValueError
        The wall clock of the rig's machine was before 1970, or after 2106.
    """
    sdk = imported("foxglove", "foxglove")
    context = sdk.Context()
    channel = transforms_channel(recording.manifest.rig, context)
    here = recording.present
    times = recording.samples["t_host_ns"] + recording.manifest.clock_offset_ns
    if not ((times >= 0) & (times < _END_NS)).all():
        msg = f"the wall clock of the rig's machine was at {times[0] / _NS:.0f} s after 1970; "
        raise InputError(f"{msg}--transforms takes 1970 to 2106: export a CSV instead")
    with sdk.open_mcap(path, allow_overwrite=True, context=context):
        for t_ns, theta_1, alpha in zip(
            times.tolist(),
            recording.theta_1[here].tolist(),
            recording.alpha[here].tolist(),
            strict=True,
        ):
            channel.log(transforms(theta_1, alpha, t_ns), log_time=t_ns)
