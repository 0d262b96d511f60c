"""A sampling time above 1 s: the device samples more often, the dataset has its instants."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.recordings.recording import Recording
from armrig_core.commands.commands import RunRequest, samples_of
from armrig_core.errors import ParameterError
from armrig_core.rig.description import builtin
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.service.virtual_service import LEASE, VirtualService

TS = 2.4
EVERY = samples_of(TS)
U = np.repeat([0.5, 2.0, 1.0, 2.0], 10)


@pytest.fixture(scope="module")
def heated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of the heater: each voltage of U was played three times."""
    heater = builtin("heater")
    timing, on = Config(timing=TimingTable(Ts=TS / EVERY)), partial(Device, description=heater)
    service = VirtualService(
        timing, tmp_path_factory.mktemp("long"), seed=3, switch_on=on, description=heater
    )
    u = U.repeat(EVERY).tolist()
    return service.record(RunRequest(lease=LEASE, n=1, u=u, details={"every": EVERY}))


def test_a_dataset_has_the_instants_of_the_sampling_time(heated: Path) -> None:
    recording = armrig.load(heated)
    data, signals = recording.dataset("T2"), recording.signals()

    assert (recording.N, recording.Ts) == (U.size * EVERY, pytest.approx(TS / EVERY))
    assert (data.N, data.Ts, signals.Ts) == (U.size, pytest.approx(TS), data.Ts)
    assert np.abs(data.u / 20 - U).max() < 0.01
    assert np.array_equal(data.y, recording["T2"][::EVERY])
    assert np.array_equal(signals.y[:, 1], data.y)


def test_a_part_of_a_recording_has_the_instants_of_the_whole(heated: Path) -> None:
    whole, part = armrig.load(heated), armrig.load(heated, start=4 * TS - 1.0)

    assert (whole.N - part.N) % EVERY
    assert np.array_equal(part.dataset().y, whole.dataset().y[4:])


def test_a_value_that_was_not_held_begins_a_new_experiment(heated: Path) -> None:
    recording = armrig.load(heated)
    held = recording.u.copy()
    held[5 * EVERY + 1] = np.nan
    held[9 * EVERY + 2] += 1.0
    other = Recording(**{f: getattr(recording, f) for f in Recording.__slots__} | {"u": held})

    data = other.dataset()

    assert U.size - data.N == 2
    assert data.starts == (0, 5, 8)


@pytest.mark.parametrize(
    ("Ts", "samples"),
    [(0.01, 1), (1.0, 1), (1.000001, 2), (1.013, 2), (2.0, 2), (15.0, 15), (59.999, 100), (60, 60)],
)
def test_samples_are_at_most_1_s_apart(Ts: float, samples: int) -> None:
    assert samples_of(Ts) == samples


@pytest.mark.parametrize("Ts", [0.0, -1.0, 60.1, float("nan")])
def test_a_sampling_time_beyond_a_minute_is_refused(Ts: float) -> None:
    with pytest.raises(ParameterError, match="must be more than 0 and at most 60, in seconds"):
        samples_of(Ts)
