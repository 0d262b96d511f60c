"""MCAP files of other programs."""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import FileError, load_data, load_signals
from armrig.cli import main
from armrig.recordings.files.catalogue import catalogue
from armrig.recordings.files.recording_summary import is_recording
from armrig_core.recording_file.manifest import OUTCOME, RUN, Outcome
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer

from tests.clients.made_recordings import manifest

N, STEP_NS = 200, 10_000_000
BEGIN_NS = 1_750_000_000_000_000_000
U = np.where(np.arange(N) // 13 % 2, 1.0, 3.0)
Y = np.zeros(N)
for _k in range(1, N):
    Y[_k] = 0.9 * Y[_k - 1] + 0.2 * U[_k - 1] + 0.01 * np.sin(9.0 * _k * _k)
TWIST = b"""Vector3 linear
float64[] more
================================================================================
MSG: geometry_msgs/Vector3
float64 x
string name
"""
Channel = tuple[str, str, tuple[str, str, bytes], Iterable[tuple[int, bytes]]]


def mcap(path: Path, *channels: Channel, how: CompressionType = CompressionType.ZSTD) -> Path:
    """Write channels: topic, encoding, schema (name, encoding, text), and messages with times."""
    out = BytesIO()
    writer = Writer(out, compression=how, chunk_size=2000)
    writer.start(profile="", library="a logger")
    for topic, encoding, (name, form, text), messages in channels:
        schema = writer.register_schema(name, form, text)
        channel = writer.register_channel(topic, encoding, schema)
        for log_time, data in messages:
            writer.add_message(channel, log_time=log_time, publish_time=0, data=data)
    writer.finish()
    path.write_bytes(out.getvalue())
    return path


def as_json(topic: str = "/motor", order: Iterable[int] = range(N), **more: Any) -> Channel:
    """Return a channel with t, voltage and angle, and further fields in each message."""
    rows = [{"t": 0.01 * k, "voltage": U[k], "angle": Y[k], **more} for k in order]
    times = [BEGIN_NS + STEP_NS * k for k in order]
    messages = [(t, json.dumps(row).encode()) for t, row in zip(times, rows, strict=True)]
    return topic, "json", ("Motor", "jsonschema", b"{}"), messages


def as_ros2(topic: str, values: Iterable[float], late_ns: int = 0) -> Channel:
    """Return a channel of std_msgs/msg/Float64."""
    messages = [
        (BEGIN_NS + STEP_NS * k + late_ns, b"\0\1\0\0" + struct.pack("<d", value))
        for k, value in enumerate(values)
    ]
    return topic, "cdr", ("std_msgs/msg/Float64", "ros2msg", b"float64 data"), messages


def assert_motor(data: armrig.Dataset) -> None:
    """Check that the data are U and Y at 0.01 s, to the last bit."""
    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_array_equal(data.y, Y)
    assert data.Ts == 0.01


@pytest.mark.parametrize("how", list(CompressionType), ids=str)
def test_the_fields_of_json_messages_are_columns(how: CompressionType, tmp_path: Path) -> None:
    motor = as_json(order=[*range(100, N), *range(100)])  # they are sorted by their log times
    path = mcap(tmp_path / "log.mcap", motor, as_json("/other", range(3)), how=how)

    data = load_data(path, topic="/motor", input="voltage", signal="angle")

    assert_motor(data)
    assert data.output == "angle"
    assert_motor(load_data(path, topic="/motor", input="voltage", signal="angle", time="t"))
    signals = load_signals(path, topic="/motor", inputs="voltage", outputs=["angle"])
    assert signals.outputs == ("angle",)


def test_nested_fields_lists_times_and_missing_values_have_paths(tmp_path: Path) -> None:
    rows = [
        {
            "head": {"stamp": {"nanosec": k % 4 * 250_000_000, "sec": 5 + k // 4}},
            "to": {"x": k, "name": "left", "far": float("nan")},
            "joints": [k, {"on": k % 2 == 0}],
            "y": None if k == 3 else k + 0.5,
        }
        for k in range(20)
    ]
    messages = [(STEP_NS * k * k, json.dumps(row).encode()) for k, row in enumerate(rows)]
    path = mcap(tmp_path / "log.mcap", ("/a", "json", ("", "", b""), messages))

    data = load_data(path, topic="/a", input="to.x", time="head.stamp")
    second = load_data(path, topic="/a", input="joints:1", signal="joints:2.on", Ts=1)

    assert (data.Ts, data.missing, data.u.tolist()) == (0.25, 1, list(range(20)))
    assert (second.u.tolist(), second.y.tolist()) == (list(range(20)), [1.0, 0.0] * 10)
    with pytest.raises(FileError, match=r"column time go from 0 to 0\.01 s.*--resample"):
        load_data(path, topic="/a", input="to.x")


def test_the_fields_of_ros_2_messages_are_columns(tmp_path: Path) -> None:
    messages = [
        (STEP_NS * k, b"\0\1\0\0" + struct.pack("<dI2sxxI4xd", U[k], 2, b"a", 1, Y[k]))
        for k in range(N)
    ]
    schema = ("geometry_msgs/msg/Twist", "ros2msg", TWIST)
    path = mcap(tmp_path / "log.mcap", ("/odom", "cdr", schema, messages))

    assert_motor(load_data(path, topic="/odom", input="linear.x", signal="more:1"))


def as_protobuf(topic: str = "/motor") -> Channel:
    """Return a channel of a message with an inner message, an optional field and a list."""
    file = FileDescriptorProto(name="motor.proto", package="lab", syntax="proto3")
    inner = file.message_type.add(name="Drive")
    inner.field.add(name="voltage", number=1, type=1, label=1)
    outer = file.message_type.add(name="Motor")
    outer.field.add(name="drive", number=1, type=11, label=1, type_name=".lab.Drive")
    outer.field.add(name="angle", number=2, type=1, label=1, proto3_optional=True, oneof_index=0)
    outer.oneof_decl.add(name="_angle")
    outer.field.add(name="more", number=3, type=2, label=3)
    pool = DescriptorPool()
    pool.Add(file)
    made = GetMessageClass(pool.FindMessageTypeByName("lab.Motor"))
    messages = []
    for k in range(N):
        message = made(drive={"voltage": U[k]}, more=[k])
        if k != 5:
            message.angle = Y[k]
        messages.append((STEP_NS * k, message.SerializeToString()))
    text = FileDescriptorSet(file=[file]).SerializeToString()
    return topic, "protobuf", ("lab.Motor", "protobuf", text), messages


def test_the_fields_of_protobuf_messages_are_columns(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", as_protobuf())

    data = load_data(path, topic="/motor", input="drive.voltage", signal="angle")

    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_array_equal(np.flatnonzero(~data.valid), [5])
    np.testing.assert_array_equal(data.y[data.valid], np.delete(Y, 5))


def test_two_topics_are_joined_at_the_times_of_the_second(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", as_ros2("/cmd", U, 1_000_000), as_ros2("/angle", Y))

    data = load_data(path, topic="/cmd,/angle", input="/cmd.data", signal="/angle.data")

    assert data.N == N - 1  # at the first time of /angle, /cmd had no value
    np.testing.assert_array_equal(data.u, U[:-1])
    np.testing.assert_array_equal(data.y, Y[1:])
    assert data.history[0] == "held the newest value of /cmd at the times of /angle"
    signals = load_signals(path, topic="/cmd,/angle", inputs="/cmd.data", outputs="/angle.data")
    assert (signals.inputs, signals.outputs) == (("/cmd.data",), ("/angle.data",))


def test_a_value_of_the_same_time_is_held_and_messages_of_the_same_time_stay_apart(
    tmp_path: Path,
) -> None:
    topic, encoding, schema, messages = as_ros2("/twice", Y)
    pairs = [(time - (k % 2) * STEP_NS, data) for k, (time, data) in enumerate(messages)]
    channels = as_ros2("/cmd", U), as_ros2("/angle", Y), (topic, encoding, schema, pairs)
    path = mcap(tmp_path / "log.mcap", *channels)

    data = load_data(path, topic="/cmd,/angle", input="/cmd.data", signal="/angle.data")
    apart = load_data(path, topic="/twice", input="time", signal="data", Ts=1)

    assert_motor(data)
    np.testing.assert_array_equal(apart.y, Y)


def test_without_a_topic_the_topics_and_their_fields_are_listed(tmp_path: Path) -> None:
    text = (
        "/words",
        "json",
        ("", "", b""),
        [(0, b'{"word": "a", "picture": [%s 0]}' % (b"0," * 99))],
    )
    path = mcap(tmp_path / "log.mcap", as_json(), text)

    said = r"/motor \(t, voltage, angle\); /words \(no numeric field\)$"
    for topic, before in ((None, "another program"), ("/rig", "topic /rig: no such topic; ")):
        with pytest.raises(FileError, match=f"{before}.*{said}"):
            load_data(path, topic=topic)
    mcap(tmp_path / "empty.mcap")
    with pytest.raises(FileError, match="and it has no messages"):
        load_data(tmp_path / "empty.mcap")


@pytest.mark.parametrize(
    ("encoding", "form", "text", "data", "said"),
    [
        ("json", "jsonschema", b"", b"{", "a message cannot be decoded .JSONDecodeError: "),
        ("json", "jsonschema", b"", b"[" * 100_000, "cannot be decoded .RecursionError: "),
        ("protobuf", "protobuf", b"\xff", b"", "messages in protobuf.*: the schema is damaged"),
        ("cdr", "ros2msg", b"float64 data", b"\0", "a message cannot be decoded"),
        ("cdr", "ros2msg", b"float64 \x1b", b"", "messages in cdr.*: the schema is damaged"),
        ("cdr", "ros2idl", b"", b"", "messages in cdr with a schema in ros2idl: armrig reads json"),
        ("ros1", "ros1msg", b"float64 data", b"", "messages in ros1 .*armrig reads json, protobuf"),
    ],
)
def test_an_undecodable_message_is_refused_with_the_remedy(
    encoding: str,
    form: str,
    text: bytes,
    data: bytes,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = mcap(tmp_path / "log.mcap", ("/a", encoding, ("pkg/msg/A", form, text), [(0, data)]))

    with pytest.raises(FileError, match=said) as refused:
        load_data(path, topic="/a")
    assert "\n" not in str(refused.value)
    assert "export" in str(refused.value)
    with pytest.raises(FileError, match=said):
        load_data(path)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("channel", [as_protobuf("/a"), as_ros2("/a", U)], ids=["protobuf", "cdr"])
def test_the_refusal_names_a_missing_extra(
    channel: Channel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("mcap_protobuf.decoder", "mcap_ros2.decoder"):
        monkeypatch.setitem(sys.modules, module, None)
    path = mcap(tmp_path / "log.mcap", channel)

    for topic in ("/a", None):
        with pytest.raises(FileError, match=r"pip install 'armrig\[mcap\]'"):
            load_data(path, topic=topic)


def test_a_file_that_is_cut_off_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = mcap(tmp_path / "log.mcap", as_json())
    whole = path.read_bytes()

    path.write_bytes(whole[: len(whole) // 2])
    data = load_data(path, topic="/motor", input="voltage", signal="angle")
    path.write_bytes(whole[:100])

    assert 20 < data.N < N
    np.testing.assert_array_equal(data.y, Y[: data.N])
    assert data.history[0].startswith("only the messages before a damage are read (the file is cut")
    with pytest.raises(FileError, match="no messages; only the messages before a damage"):
        load_data(path)


def test_topics_are_accepted_only_for_mcap_files(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text("u,y\n1,2\n")

    with pytest.raises(FileError, match="topic /a: only MCAP files have topics"):
        load_data(tmp_path / "data.csv", topic="/a")
    with pytest.raises(FileError, match=r"is a recording and not a table; armrig\.load"):
        load_data(armrig.example_recording().path)


def run(line: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = main(line.split())
    said = capsys.readouterr()
    return code, said.out + said.err


def test_the_command_line_reads_a_topic(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mcap(tmp_path / "log.mcap", as_json())
    given = "--input voltage --signal angle"
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path / "recordings"))

    refused, listed = run(f"hints {path}", capsys)
    _, named = run(f"identify {path} --structure oe {given}", capsys)
    assert run(f"import {path} {given} --topic /motor", capsys)[0] == 0
    code, said = run("identify @log --structure arx --na 1 --nb 1", capsys)

    assert code == 0
    assert "a1 …   -0.89951 ± 0.00027\n  b1 …   0.20076 ± 0.00047" in said
    assert refused == 1
    assert "/motor (t, voltage, angle)" in listed
    assert f"`armrig import {path} {given} --topic NAME`" in named
    assert "/motor (t, voltage, angle)" in named


def test_a_recording_rewritten_by_another_program_is_read(tmp_path: Path) -> None:
    path = tmp_path / "copy.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="a program that copies " * 5)
        writer.add_metadata(RUN, manifest().metadata())
        writer.add_metadata(OUTCOME, Outcome(outcome="complete", samples=0, missing=0).metadata())
        writer.finish()

    assert is_recording(path)
    assert catalogue(tmp_path).recordings[0].file == "copy.mcap"


def test_files_of_other_programs_are_not_called_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mcap(tmp_path / "log.mcap", as_json())
    cut = mcap(tmp_path / "cut.mcap", as_json())
    cut.write_bytes(cut.read_bytes()[:-200])

    _, listed = run("ls .", capsys)
    _, facts = run("ls . --json", capsys)

    assert "damaged" not in listed
    assert "not made by armrig: " in listed
    left_out = json.loads(facts.partition("\n")[0])["left_out"]
    assert [(one["why"], one["foreign"]) for one in left_out] == [("not made by armrig", True)] * 2
    for name in ("log.mcap", "cut.mcap"):
        assert f"{name}: not made by armrig; " in run(f"info {name}", capsys)[1]
