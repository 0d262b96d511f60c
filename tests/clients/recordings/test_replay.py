"""`armrig replay` finds differences between a recording and the core's present decisions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.recordings.files.replay import Replay, _messages, replay
from armrig_core.commands.commands import RunRequest
from armrig_core.errors import OperationError
from armrig_core.rig.description import Description, builtin
from armrig_core.telemetry.telemetry import decode_sample, encode_sample
from armrig_core.telemetry.topics import stream_of
from armrig_daemon.config import Config
from armrig_daemon.decisions.state import Emit
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Log
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from mcap.reader import make_reader
from mcap.writer import Writer

Change = Callable[[str, int, bytes], bytes | None]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a run of 300 samples whose voltage is another one each time."""
    rig = VirtualService(Config(), tmp_path_factory.mktemp("run"), seed=3)
    u = np.linspace(0.5, 4.0, 300).tolist()
    return rig.record(RunRequest(lease=LEASE, n=0, u=u, experiment="blackbox", details={}))


def replayed(run: Path, path: Path, change: Change, volts: bytes = b"") -> Replay:
    """Return the replay of a copy.

    `change` gives the payload of message n of a stream as it is in the copy, or None for none. The
    input's first voltage is `volts`, if that is given.
    """
    counts: dict[str, int] = {}
    with run.open("rb") as source, path.open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start()
        for record in reader.iter_metadata():
            metadata = dict(record.metadata)
            if volts:  # as in an older file: another input than that of the hash is refused
                metadata.pop("input_sha256", None)
            writer.add_metadata(record.name, metadata)
        for a in reader.iter_attachments():
            lines = a.data.split(b"\n")
            if volts and a.name == "input.csv":
                lines[1] = volts
            data = b"\n".join(lines)
            writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, data)
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.topic not in channels:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", own)
            stream = stream_of(channel.topic)
            n = counts[stream] = counts.get(stream, -1) + 1
            data = change(stream, n, message.data)
            if data is not None:
                times = message.log_time, data, message.publish_time, message.sequence
                writer.add_message(channels[channel.topic], *times)
        writer.finish()
    return replay(path)


def test_the_replay_of_a_copy_equals_the_run(run: Path, tmp_path: Path) -> None:
    found = replayed(run, tmp_path / "a.mcap", lambda _, __, data: data)

    assert found.difference == found.until == ""
    assert found.samples == 300
    assert found.frames <= found.steps
    assert found.seconds == pytest.approx(3.0, abs=0.3)
    assert replay(run) == found


@pytest.mark.parametrize("n", [0, 57, 299])
def test_a_replay_reports_a_changed_sample(run: Path, tmp_path: Path, n: int) -> None:
    def change(stream: str, i: int, data: bytes) -> bytes:
        if (stream, i) != ("sample", n):
            return data
        one = decode_sample(data)
        assert one is not None
        return encode_sample(one._replace(counts_1=one.counts_1 + 1))

    found = replayed(run, tmp_path / "a.mcap", change)

    assert found.samples == n
    same = f"the first {n} are the same"
    assert found.difference == f"the file has 300 samples, the replay has 300; {same}"


def test_a_replay_reports_the_frame_of_a_changed_input(run: Path, tmp_path: Path) -> None:
    found = replayed(run, tmp_path / "a.mcap", lambda _, __, data: data, volts=b"0.75")

    sent, now = found.difference.partition(": ")[2].split(", now decides ")
    assert found.difference.startswith("step ")
    assert sent.startswith("sent ")
    assert sent.removeprefix("sent ") != now
    assert found.samples < 300
    assert found.steps < armrig.load(run).N


@pytest.mark.parametrize(
    ("gone", "said"), [({7}, "1 chunk of steps is"), ({3, 4, 9}, "3 chunks of steps are")]
)
def test_a_replay_counts_missing_steps(
    run: Path, tmp_path: Path, gone: set[int], said: str
) -> None:
    def change(stream: str, n: int, data: bytes) -> bytes | None:
        return None if stream == "trace" and n in gone else data

    found = replayed(run, tmp_path / "a.mcap", change)

    assert found.difference == f"{said} missing from the file"
    assert 0 < found.samples < 300


def test_a_replay_reports_only_warnings_and_errors_of_the_core() -> None:
    levels = ("debug", "info", "warning", "error")
    actions = [
        Emit(Log(t_host_ns=3_500_000_000 + k, level=level, message=f"a {level}"))
        for k, level in enumerate(levels)
    ]

    told = list(_messages(actions, 2_000_000_000))

    assert [(one.level, one.message) for one in told] == [
        *(("warning", "a warning"), ("error", "a error")),
    ]
    assert told[0].t == pytest.approx(1.5, abs=1e-8)


def test_a_stop_by_a_measured_output_is_decided_again(tmp_path: Path) -> None:
    limited = builtin("arm").text.replace(b"zero_counts", b"high = 0.1\nzero_counts")
    limited = limited.replace(b"theta_1", b"position").replace(b"alpha", b"deflection")
    soft = Config(emulator=EmulatorSettings(arm={"K_lin": 0.2}))  # softer than in the rehearsal
    rig = VirtualService(soft, tmp_path, seed=3, description=Description.of(limited))
    with pytest.raises(OperationError, match=r"deflection = .* rad is above 0\.1 rad"):
        rig.record(RunRequest(lease=LEASE, n=0, u=[0.0] * 50 + [4.0] * 250, experiment="own"))

    (path,) = tmp_path.glob("*.mcap")
    found = replay(path)

    assert not found.difference
    assert 50 < found.samples < 300
