"""Real-time properties that the kernel refuses to the loop, each with its remedy."""

from __future__ import annotations

import pytest
from armrig_daemon.loop import realtime


@pytest.mark.parametrize(
    ("asked", "cpu", "fifo", "is_granted", "refused"),
    [
        (80, 1, 80, True, []),
        (80, None, 0, True, ["SCHED_FIFO (set LimitRTPRIO= or run under systemd's unit)"]),
        (80, None, 5, True, ["priority 80 (it is 5; set LimitRTPRIO=80)"]),
        (0, None, 0, True, []),
        (0, None, 1, True, ["priority 0 (it is 1; set LimitRTPRIO=0)"]),
        (
            80,
            0,
            80,
            False,
            [
                "mlockall (set LimitMEMLOCK=infinity)",
                "/dev/cpu_dma_latency (a udev rule may give the group write access)",
                "cpu 0 (allowed are [1, 3])",
            ],
        ),
        (
            80,
            None,
            80,
            False,
            [
                "mlockall (set LimitMEMLOCK=infinity)",
                "/dev/cpu_dma_latency (a udev rule may give the group write access)",
            ],
        ),
    ],
)
def test_each_refusal_is_told_apart(
    asked: int,
    cpu: int | None,
    fifo: int,
    is_granted: bool,
    refused: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Kernel:
        def prctl(self, *_: int) -> int:
            return 0

        def mlockall(self, _: int) -> int:
            return 0 if is_granted else -1

    monkeypatch.setattr(realtime, "_libc", Kernel())
    monkeypatch.setattr(realtime, "_set_fifo", lambda priority: fifo)
    monkeypatch.setattr(realtime, "_keep_awake", lambda: is_granted)
    monkeypatch.setattr(realtime, "_pin", lambda cpu: cpu is not None and is_granted)
    monkeypatch.setattr(realtime.os, "sched_getaffinity", lambda _: {3, 1})
    for name in ("collect", "freeze", "disable"):
        monkeypatch.setattr(realtime.gc, name, lambda: None)

    assert realtime.prepare(asked, cpu) == {
        "fifo": fifo,
        "mlockall": is_granted,
        "cpu": cpu,
        "awake": is_granted,
        "refused": refused,
    }
