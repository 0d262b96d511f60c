"""Real-time properties that the kernel refuses to the loop, each with its remedy."""

from __future__ import annotations

from types import SimpleNamespace
from unittest import mock

import pytest
from armrig_core.process import realtime


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
def test_each_refused_scheduling_privilege_is_reported_by_its_name(
    asked: int,
    cpu: int | None,
    fifo: int,
    is_granted: bool,
    refused: list[str],
) -> None:
    kernel = SimpleNamespace(prctl=lambda *_: 0, mlockall=lambda _: 0 if is_granted else -1)
    with mock.patch.multiple(
        realtime,
        _libc=kernel,
        _set_fifo=lambda priority: fifo,
        _keep_awake=lambda: is_granted,
        _pin=lambda cpu: cpu is not None and is_granted,
        os=SimpleNamespace(sched_getaffinity=lambda _: {3, 1}),
        gc=SimpleNamespace(collect=int, freeze=int, disable=int),
    ):
        found = realtime.prepare(asked, cpu)

    assert found == {
        "fifo": fifo,
        "mlockall": is_granted,
        "cpu": cpu,
        "awake": is_granted,
        "refused": refused,
    }
