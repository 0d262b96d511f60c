"""One message of a daemon that is recorded from afar: decoded, and checked as one of a stranger."""

from __future__ import annotations

from typing import Any, NamedTuple

from armrig_core.errors import InputError
from armrig_core.recording_file.outgoing import Outgoing
from google.protobuf.message import DecodeError

from armrig.recordings.grid import TS_LEAST_S, TS_LIMIT_S
from armrig.rig.session import RigError
from armrig.rig.telemetry_stream import decoded

_LIMIT = 1 << 62
"""Above any time in ns, and any index of a sample."""


class RemoteMessage(NamedTuple):
    """A message, and when it was published."""

    stream: str
    data: bytes
    value: Any
    """A `Sample`, or a protobuf message."""
    t_ns: int
    """On the host's monotonic clock."""

    def outgoing(self) -> Outgoing:
        """Return it as a recorder takes it."""
        due_ns, number = self.t_ns, 0
        if self.stream == "sample":
            due_ns, number = self.value.t_sched_ns, self.value.k
        return Outgoing(self.stream, self.t_ns, due_ns, number, self.data)


def remote_message(stream: str, data: bytes, clock_offset_ns: int) -> RemoteMessage:
    """Return a message as it came.

    Parameters
    ----------
    clock_offset_ns : int
        Real-time clock less monotonic clock, where it was made.

    Raises
    ------
    RigError
        It is none that a daemon sends.
    """
    try:
        if not 0 <= clock_offset_ns < _LIMIT:
            raise InputError(f"a clock offset of {clock_offset_ns} ns")
        value = decoded(stream, data)
        _check(stream, value)
    except (ValueError, DecodeError) as err:
        raise RigError(
            f"{len(data)} B of the stream {stream!r} are no message of armrigd's ({err})"
        ) from err
    return RemoteMessage(stream, data, value, _host_ns(stream, value, clock_offset_ns))


def _check(stream: str, value: Any) -> None:
    """Refuse what no recording can hold, or no reader of one would take."""
    times: list[int] = []
    if stream == "sample":
        times = [value.t_host_ns, value.t_sched_ns, value.k]
    elif stream == "gap":
        times = [value.t_from_ns, value.t_to_ns, value.k_first + value.count]
    elif stream != "event":
        times = [value.t_host_ns]
    for time in times:
        if not 0 <= time < _LIMIT:
            raise InputError(f"a time or an index of {time}")
    # Until a rig is there it has no sampling time.
    if stream == "state" and value.Ts_s != 0 and not TS_LEAST_S <= value.Ts_s < TS_LIMIT_S:
        raise InputError(f"a sampling time of {value.Ts_s:g} s")


def _host_ns(stream: str, value: Any, clock_offset_ns: int) -> int:
    if stream == "event":
        stamp = value.timestamp
        told_ns = int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos) - clock_offset_ns
        return min(max(told_ns, 0), _LIMIT)  # the real-time clock may have been set
    return int(value.t_to_ns if stream == "gap" else value.t_host_ns)
