"""The n-th system call fails, for each n of a run of 2 s: the loop's, then the recorder's.

SQLite's way of testing: any call fails, once or from then on. The motor never has a voltage that
was not commanded or is out of bounds, nothing hangs, and a file that loads or a message remains.
These tests try each 37th n.

References
----------
.. [1] D. R. Hipp, "How SQLite Is Tested", sqlite.org/testing.html, section 3.
"""

from __future__ import annotations

from itertools import count, pairwise, product
from pathlib import Path
from unittest import mock

import armrig
import msgspec
import pytest
from armrig_core.commands.codes import COMPLETE
from armrig_core.recording_file import recorder
from armrig_core.recording_file.manifest import Manifest
from armrig_core.recording_file.recorder import ActiveRecording, RecordingError
from armrig_core.telemetry.telemetry import Outgoing, Sample, decode_sample, encode_sample
from armrig_daemon.config import Config
from armrig_daemon.pipe import Answer, Arm, Gap, Log, Run, RunEnded, RunStarted

from tests.daemon.failing_disk import Disk
from tests.daemon.failing_world import WAYS, World
from tests.daemon.virtual_bench import LEASE, MS, codes

STRIDE = 37
N = 50
U = [1.0, 4.0] * (N // 2)
CONFIG = Config(timing=msgspec.structs.replace(Config().timing, Ts=0.02))
RUN_NS, END_NS = 500 * MS, 2000 * MS
WATCHDOG_NS = 101 * MS
_STEP_V = 5 / 1024  # of the emulated duty


def played(*args: object, scheduled: bool, on: bool = False, until_ns: int = END_NS) -> World:
    """Play a run of one second with a failing call; check all invariants."""
    world = World(CONFIG, *args, on=on)
    world.order(300 * MS, Arm(order=1, owner="a test", lease=LEASE, ts_us=0))
    play = Run(order=2, lease=LEASE, n=0, run_id="r", codes=codes(*U), scheduled=scheduled)
    world.order(RUN_NS, play)
    records = world.run_until(until_ns)
    _no_voltage_but_what_was_asked_for(world)
    _told(world, records)
    return world


def _no_voltage_but_what_was_asked_for(world: World) -> None:
    allowed = (0.0, *sorted(set(U)))
    for change, after in pairwise([*world.changes, None]):
        if change is None or change.volts == 0.0:
            continue
        assert min(abs(change.volts - volts) for volts in allowed) <= _STEP_V, change
        ends_ns = after.t_ns if after else world.now_ns
        assert after is not None, "the motor turns at the end"
        assert ends_ns - change.t_ns <= 20 * MS + WATCHDOG_NS, change
        if world.lost_ns >= 0:  # the link was given up: nothing reaches the device but time
            assert ends_ns <= world.lost_ns + WATCHDOG_NS, (change, world.lost_ns)
    last = max((change.t_ns for change in world.changes), default=0)
    assert last <= RUN_NS + 100 * MS + N * 20 * MS + WATCHDOG_NS, "driven on behind the run's end"


def _told(world: World, records: list[object]) -> None:
    """Check that every sample is there, or in a gap, and that an early end has a reason."""
    samples = {s.k for r in records if isinstance(r, bytes) and (s := decode_sample(r))}
    gaps = [r for r in records if isinstance(r, Gap)]
    ks = samples.union(*(range(g.k_first, g.k_first + g.count) for g in gaps))
    if world.calls["put"] and ks and world._kind != "put":
        assert ks == set(range(min(ks), max(ks) + 1))
    words = [r.outcome for r in records if isinstance(r, RunEnded)]
    if "complete" in words or world.failed_ns < 0 or world._kind in ("put", "orders"):
        return  # after these failures the loop can report nothing; the service reports it
    words += [r.message for r in records if isinstance(r, Log) and r.level != "debug"]
    words += [r.error for r in records if isinstance(r, Answer)]
    assert any(words), records
    if any(isinstance(r, RunStarted) for r in records):
        assert any(isinstance(r, RunEnded) for r in records), "a run that never ends"


def all_n(kind: str, *, scheduled: bool) -> int:
    """Return how many calls of a kind there are in a run in which none fails."""
    return played(scheduled=scheduled).calls[kind]


CASES = [(kind, way) for kind, ways in WAYS.items() for way in ways if kind != "open"]


def try_every(kind: str, way: int | str, *, scheduled: bool, stride: int = 1) -> int:
    """Let the n-th call fail, once and from then on, for every `stride`-th n; return how many."""
    total = all_n(kind, scheduled=scheduled)
    tried = 0
    for n in range(1, total + 1, stride):
        for on in (False, True):
            played(kind, n, way, scheduled=scheduled, on=on)
            tried += 1
    return tried


@pytest.mark.parametrize(("kind", "way"), CASES)
@pytest.mark.parametrize("scheduled", [False, True])
def test_the_motor_stops_in_time_if_any_system_call_of_the_loop_fails(
    kind: str, way: int | str, *, scheduled: bool
) -> None:
    assert try_every(kind, way, scheduled=scheduled, stride=1 if kind == "orders" else STRIDE)


# -- the recorder ------------------------------------------------------------------------------

SAMPLES, BATCH = 200, 20
MANIFEST = Manifest(
    **{"rig": "1", "run_id": "r", "experiment": "test", "details": {}, "Ts": 0.01},
    **{"samples": SAMPLES, "started": "2026-01-01T00:00:00+00:00", "clock_offset_ns": 10**18},
    **{"armrig": "0", "protocol": "1"},
)


def _sample(k: int) -> Outgoing:
    t_ns = k * 10_000_000
    data = encode_sample(Sample(k, t_ns, t_ns + 5, k, 0.1, 0.2, 1.0, 1.0, 1, 2, 3))
    return Outgoing("sample", t_ns + 5, t_ns, k, data)


def _refused(err: RecordingError, directory: Path) -> None:
    assert "No space left on device; free disk space" in str(err)
    assert not list(directory.iterdir())


def recorded(directory: Path, disk: Disk) -> ActiveRecording | None:
    """Record 2 s on a disk, each batch flushed and synced; check the files and the messages."""
    with (
        disk.installed(),
        mock.patch.object(recorder, "FLUSH_S", 0.0),
        mock.patch.object(recorder, "SYNC_S", 0.0),
    ):
        path = disk.path(directory / "run.mcap")
        try:
            recording = ActiveRecording.create(
                path, MANIFEST, {}, t_first_ns=5, changed=lambda: None
            )
        except RecordingError as err:
            _refused(err, directory)
            return None
        for k in range(0, SAMPLES, BATCH):
            recording.add([_sample(i) for i in range(k, k + BATCH)])
        recording.finish(COMPLETE)
        recording.join(30)
    assert recording.done, "the writer hangs"
    (left,) = directory.iterdir()  # one file, whatever failed
    assert left == Path(recording.kept)
    found = armrig.load(left)
    assert found.samples["k"].tolist() == list(range(found.samples.size))
    whole = found.samples.size == SAMPLES and not found.truncated
    assert whole or f"{left}: No space left on device; " in recording.error
    if left.name == "run.mcap.active":
        assert "the flushed samples are kept there" in recording.error
    else:
        assert not found.truncated
    assert recording.synced <= found.samples.size  # what was acknowledged is there
    return recording


def try_every_disk_call(directory: Path) -> tuple[int, int]:
    """Let the n-th call fail, once and from then on, for every n; return counts and messages."""
    counted = Disk()
    (directory / "counted").mkdir()
    recorded(directory / "counted", counted)
    assert counted.calls["write"] > SAMPLES / BATCH
    tried = told = 0
    for kind, on in product(counted.calls, (False, True)):
        # How often the writer flushes is a matter of time: on until an n-th call does not come.
        for n in count(1):
            disk = Disk(kind, n, on=on)
            of_its_own = directory / f"{kind}-{n}-{on}"
            of_its_own.mkdir()
            recording = recorded(of_its_own, disk)
            if not disk.failed:
                assert n > 1, f"{kind}: no call of it failed"
                break
            tried += 1
            told += recording is None or bool(recording.error)
    return tried, told


def test_the_file_loads_after_a_failure_of_any_system_call_of_the_recorder(tmp_path: Path) -> None:
    tried, told = try_every_disk_call(tmp_path)

    # The compact copy fails without a word: the first is complete.
    assert tried / 2 < told < tried
