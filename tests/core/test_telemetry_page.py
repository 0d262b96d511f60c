"""docs/telemetry.md: its tables agree with the schemas."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from armrig_core.commands import commands
from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_core.telemetry import protobuf, topics
from armrig_protocol.messages import Flag
from google.protobuf import descriptor_pb2

TEXT = (Path(__file__).parents[2] / "docs" / "telemetry.md").read_text(encoding="utf-8")


def _table(heading: str) -> list[list[str]]:
    """Return the rows of all tables below a heading, without their heads."""
    below = re.split(r"\n#+ ", TEXT.split(f"# {heading}\n")[1])[0]
    lines = [line for line in below.splitlines() if line.startswith("| ")]
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]
    return [row for row in rows if row[0] not in ("key", "field", "flag", "command")]


def _messages() -> dict[str, descriptor_pb2.DescriptorProto]:
    """Return each message that armrig defines, by its full name."""
    sets = (protobuf.descriptor_set(name) for name in protobuf.OF_STREAM.values())
    files = [f for data in sets for f in descriptor_pb2.FileDescriptorSet.FromString(data).file]
    return {
        f"{file.package}.{message.name}": message
        for file in files
        for message in file.message_type
        if file.package != "google.protobuf"
    }


def _kind(field: descriptor_pb2.FieldDescriptorProto) -> str:
    """Return a field's type as in a .proto file, or the name of a message of the same file."""
    if field.type_name:
        return re.sub(r"^\.(armrig\.v1|foxglove\.Log)?\.?", "", field.type_name)
    return descriptor_pb2.FieldDescriptorProto.Type.Name(field.type).removeprefix("TYPE_").lower()


@pytest.mark.parametrize("name", _messages())
def test_every_field_is_documented_in_its_order(name: str) -> None:
    fields = [(field.name, _kind(field)) for field in _messages()[name].field]
    told = [(row[0], row[1]) for row in _table(name) if not row[0].startswith("0x")]

    assert [field.number for field in _messages()[name].field] == list(range(1, len(fields) + 1))
    assert told == fields


def test_every_flag_is_documented() -> None:
    rows = [row for row in _table("armrig.v1.Sample") if row[0].startswith("0x")]

    assert {row[1]: int(row[0], 16) for row in rows} == {flag.name: int(flag) for flag in Flag}


def test_every_key_is_documented_with_its_encoding() -> None:
    told = {key.strip("`"): encoding.strip("`") for key, _, encoding in _table("Keys")[:7]}

    assert told == {
        topics.stream_key("<id>", stream): f"application/protobuf;{protobuf.OF_STREAM[stream]}"
        for stream in topics.STREAMS
    }
    assert [row[0].strip("`") for row in _table("Keys")[7:]] == [
        topics.schema_key("<id>", "<message>"),
        topics.schema_key("<id>", "cmd/<command>"),
        topics.command_key("<id>", "<command>"),
        topics.history_key("<id>"),
        topics.alive_key("<id>"),
    ]


def test_every_command_is_documented_with_its_fields() -> None:
    told = {row[0]: [field for field in row[1].split(", ") if field] for row in _table("Commands")}

    assert told == {name: list(kind.__struct_fields__) for name, kind in commands.REQUESTS.items()}


def test_every_refusal_is_documented_with_its_retry() -> None:
    rows = [row for row in _table("Refusals") if len(row) == 3 and row[0] != "---"]

    told = {code: passes for code, _, passes in rows if code != "code"}
    assert told == {code.value: "yes" if code.passes else "no" for code in RefusalCode}


def test_every_outcome_is_documented() -> None:
    told = [row[0] for row in _table("Outcomes") if row[0] not in ("code", "---")]

    assert told == [code.value for code in OutcomeCode]


def test_every_code_of_a_gap_is_documented_with_its_sentence() -> None:
    told = dict(row[:2] for row in _table("Reasons of gaps") if row[0] not in ("code", "---"))

    assert list(told) == [code.value for code in GapCode]
    for code in GapCode:
        if code not in (GapCode.FAULT, GapCode.UNKNOWN):
            assert told[code] == code.sentence
