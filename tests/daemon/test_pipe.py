"""Records and orders survive the pipe, in any pieces."""

from __future__ import annotations

from typing import get_args

from armrig_core.commands.codes import GapCode
from armrig_core.telemetry.channels import SAMPLE_FIELDS
from armrig_core.telemetry.telemetry import Sample, encode_sample
from armrig_daemon.pipe import (
    Answer,
    Arm,
    Gap,
    Log,
    Orders,
    Run,
    Stop,
    record_bytes,
    sample_bytes,
    take_orders,
    take_records,
)
from hypothesis import given
from hypothesis import strategies as st

SAMPLE = encode_sample(Sample(*range(len(SAMPLE_FIELDS))))
LATE = GapCode.HOST_LATE
GAP = Gap(k_first=3, count=2, t_from_ns=1, t_to_ns=2, u_held_v=2.5, reason=LATE.sentence, code=LATE)
LOG = Log(t_host_ns=5, level="info", message="a rig")
ANSWER = Answer(order=3, body={"lease": "x"})


@given(st.lists(st.integers(1, 60), max_size=20))
def test_records_pass_through_the_pipe_unchanged(cuts: list[int]) -> None:
    stream = sample_bytes(SAMPLE) + record_bytes(GAP) + record_bytes(LOG)
    stream += sample_bytes(SAMPLE) + record_bytes(ANSWER)
    pending, records = bytearray(), []
    for size in [*cuts, len(stream)]:
        pending += stream[:size]
        stream = stream[size:]
        records += take_records(pending)

    assert records == [SAMPLE, GAP, LOG, SAMPLE, ANSWER]
    assert not pending


def test_orders_pass_through_the_pipe_unchanged() -> None:
    orders = [
        Arm(order=1, owner="a student", lease="a" * 32, ts_us=0),
        Run(order=2, lease="a" * 32, n=0, run_id="r", codes=b"\x00\x80" * 1_000_000),
        Stop(order=3),
    ]

    pending = bytearray().join(map(record_bytes, orders))

    assert take_orders(pending) == orders


def test_orders_are_tagged_with_their_names() -> None:
    tags = {kind.__struct_config__.tag for kind in get_args(Orders)}

    assert tags == {
        "Arm",
        "Disarm",
        "Set",
        "SetReference",
        "Run",
        "Stop",
        "Reset",
        "Calibrate",
        "Alive",
        "Quit",
    }
