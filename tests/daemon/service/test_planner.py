"""The process that plans runs: its bounds, its end, and what follows it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import MOST_SAMPLES, Refused, RunOptions, RunRequest
from armrig_core.rig.description import Description, builtin, read_description
from armrig_daemon.config import Config, Limits
from armrig_daemon.service.host.planner import Job, Planner
from armrig_daemon.service.plan import RunPlan, decode_run

from tests.integration.processes import wait_for

LEASE = "a" * 32
MOST_MIB = 300
BUSY = """
import armrig
def f(t, x, u, p):
    while t.min() > 0.1:
        pass
    return [u[0] - x[0]]
model = armrig.Ode(f, output=lambda t, x, u, p: x[0], states=["level"], parameters={})
"""
LEVEL = """[rig]
name = "level"
[outputs.level]
unit = "V"
per_count = 8e-5
valid_rail = "low"
"""


class Plans:
    """A planner, and what it has made."""

    def __init__(self, description: Description) -> None:
        self._woken = threading.Event()
        self.planner = Planner(description, self._woken.set, os.dup(2))
        self._number = 0

    def asked(self, payload: bytes, config: Config | None = None) -> int:
        """Ask for a plan; return its number."""
        self._number += 1
        self.planner.plan(Job(self._number, payload, 0.01, config or Config(), None))
        return self._number

    def close(self) -> None:
        """End thread and process."""
        self.planner.close()
        self.planner._thread.join(60)

    def made(self, number: int) -> Any:
        """Return the plan, or its refusal."""
        found: list[Any] = []
        wait_for(lambda: found.append(self.planner.result(number)) or _is_end(found[-1]), 120)
        return found[-1]


def _is_end(found: object) -> bool:
    return found is not None and not isinstance(found, RunOptions)


@pytest.fixture
def plans() -> Iterator[Plans]:
    """Give a planner of the arm's runs."""
    plans = Plans(builtin("arm"))
    yield plans
    plans.close()


def _payload(u: Any, **options: Any) -> bytes:
    return msgspec.json.encode(RunRequest(lease=LEASE, n=1, u=u, **options))


def test_a_plan_contains_the_input_and_its_rehearsal(plans: Plans) -> None:
    plan = plans.made(plans.asked(_payload([0.0, 2.5, 5.0], experiment="x")))

    assert isinstance(plan, RunPlan)
    assert (plan.samples, plan.source.hex(), plan.options.experiment) == (3, "00000080ffff", "x")
    assert plan.text == b"u_v\n0.0\n2.5\n5.0\n"
    assert plan.rehearsal is not None


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (_payload([4.0]), "u[0]=4 V is outside 0 … 3 V"),
        (b'{"u": [6.0]}', "run: Object missing required field `lease`"),
        (b"no JSON", "run: JSON is malformed"),
    ],
)
def test_a_run_that_is_not_allowed_is_refused(plans: Plans, payload: bytes, said: str) -> None:
    refused = plans.made(plans.asked(payload, Config(limits=Limits(u_max_v=3.0))))

    assert isinstance(refused, Refused)
    assert refused.code == RefusalCode.NOT_ALLOWED
    assert said in refused.error


def test_a_process_that_is_killed_is_replaced(plans: Plans) -> None:
    plans.made(plans.asked(_payload([1.0])))
    process = plans.planner._process
    assert process is not None
    process.send_signal(signal.SIGSTOP)
    number = plans.asked(_payload([1.0] * 200_000))  # more than a pipe holds
    wait_for(plans.planner._numbers.empty)
    threading.Event().wait(0.2)
    process.kill()

    refused = plans.made(number)

    assert (refused.code, refused.error) == (
        RefusalCode.INTERNAL,
        "the planning process ended with code -9: send the run again",
    )
    assert isinstance(plans.made(plans.asked(_payload([1.0]))), RunPlan)


def test_a_cancelled_plan_is_dropped_and_the_next_is_made(plans: Plans) -> None:
    first = plans.asked(_payload([1.0] * 200_000))
    plans.planner.cancel()
    plan = plans.made(plans.asked(_payload([2.0])))

    assert plan.samples == 1
    assert plans.planner.result(first) is None


@pytest.mark.parametrize("n", [1, 70_000, 300_000])
def test_an_input_is_decoded_in_pieces(n: int) -> None:
    u = np.random.default_rng(n).uniform(0, 5, n)

    _, found = decode_run(_payload(u.tolist()))

    np.testing.assert_array_equal(found, u)


@pytest.mark.parametrize(
    "u", ["[]", "5", "[1, [2, 3]]", '["1,2"]', "[1, 2, NaN]", "[1,, 2]", "[1, 6]", "[true]", "{}"]
)
def test_an_input_is_refused_as_by_the_schema(u: str) -> None:
    payload = f'{{"lease": "{LEASE}", "n": 1, "u": {u}}}'.encode()
    with pytest.raises(msgspec.DecodeError):
        msgspec.json.decode(payload, type=RunRequest)

    with pytest.raises(ValueError, match="run: "):
        decode_run(payload)


@pytest.mark.exhaustive
def test_the_longest_run_of_forty_states_needs_little_memory(tmp_path: Path) -> None:
    A, B = -np.diag(np.arange(1.0, 41.0)), [[1.0]] * 40
    file = tmp_path / "rig.toml"
    file.write_text(f"{LEVEL}[model]\nA = {A.tolist()}\nB = {B}\nC = {[[0.01] * 40]}\n")
    plans = Plans(read_description(file))
    u = np.random.default_rng(1).uniform(0, 5, MOST_SAMPLES)

    plan = plans.made(plans.asked(_payload(u.tolist())))

    assert plan.samples == MOST_SAMPLES
    process = plans.planner._process
    assert process is not None
    status = Path(f"/proc/{process.pid}/status").read_text()
    (peak,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    assert int(peak) < MOST_MIB << 10
    plans.close()


@pytest.mark.exhaustive
def test_equations_that_never_end_are_ended_by_their_processor_time(tmp_path: Path) -> None:
    (tmp_path / "busy.py").write_text(BUSY)
    (tmp_path / "rig.toml").write_text(f'{LEVEL}[model]\nfile = "busy.py"\n')
    plans = Plans(read_description(tmp_path / "rig.toml"))

    refused = plans.made(plans.asked(_payload([1.0] * 100)))

    assert refused.code == RefusalCode.NOT_ALLOWED
    assert "the file took more than 4 s of processor time: play fewer samples" in refused.error
    plans.close()
