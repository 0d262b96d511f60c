"""Generate the protocol tables from `schema.toml`: `python -m armrig_protocol.generate [--check]`.

The program writes `armrig_protocol/messages.py`, `firmware/rig_protocol.h`, the tables of
`PROTOCOL.md` between two marks, and the vectors of the messages in `vectors/frames.json`. With
`--check` it writes nothing, and its exit code is 1 if a file differs from the schema.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Iterator, Sequence
from hashlib import shake_128
from pathlib import Path
from struct import Struct
from typing import Any
from zlib import crc32

from armrig_protocol import cobs

ROOT = Path(__file__).parent.parent
SIZES = {"u8": 1, "u16": 2, "u32": 4, "u64": 8}
PYTHON = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q"}
C = {"u8": "uint8_t", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t"}
HEADER = (
    {"name": "state", "type": "u8", "enum": "State", "doc": "state of the device; 0 from a host"},
    {"name": "seq", "type": "u16", "doc": "number of the frame, counted by its sender"},
)
BEGIN, END = "<!-- tables: begin -->", "<!-- tables: end -->"

Table = dict[str, Any]


def schema_hash(schema: Table) -> int:
    """Return the CRC-32 of the schema without `doc` and `unit`, which do not affect the bytes."""

    def bare(node: object) -> object:
        if isinstance(node, dict):
            return {key: bare(value) for key, value in node.items() if key not in {"doc", "unit"}}
        return [bare(item) for item in node] if isinstance(node, list) else node

    return crc32(json.dumps(bare(schema), sort_keys=True).encode())


def wire_name(message: Table) -> str:
    """Return the name of a message in PROTOCOL.md, for example CLEAR_FAULT for ClearFault."""
    if "wire" in message:
        return str(message["wire"])
    name = message["name"]
    return "".join(f"_{c}" if i and c.isupper() else c for i, c in enumerate(name)).upper()


def frame_length(message: Table) -> int:
    """Return the length of a frame before stuffing, including header and CRC, in bytes."""
    body: int = sum(SIZES[field["type"]] * field.get("count", 1) for field in message["fields"])
    return 4 + body + 4


def field_doc(field: Table) -> str:
    """Return the description of a field with its unit and the name of its enumeration."""
    meaning, semicolon, details = field["doc"].partition(";")
    unit = f", in {field['unit']}" if "unit" in field else ""
    names = f" (`{field['enum']}`)" if "enum" in field else ""
    return f"{meaning}{unit}{semicolon}{details}{names}"


def python_text(schema: Table) -> str:
    """Return the text of `messages.py`."""
    return "\n".join(_python_lines(schema)) + "\n"


def _python_lines(schema: Table) -> Iterator[str]:
    yield '"""Messages of the wire; generated from schema.toml, not to be edited.'
    yield ""
    yield "`python -m armrig_protocol.generate` makes this file. Fields are raw integers."
    yield '"""'
    yield ""
    yield "from __future__ import annotations"
    yield ""
    yield "from enum import IntEnum, IntFlag"
    yield "from typing import NamedTuple"
    yield ""
    yield f"VERSION = {schema['version']}"
    yield '"""Version of the protocol."""'
    yield f"SCHEMA_HASH = 0x{schema_hash(schema):08X}"
    yield '"""CRC-32 of the schema; host and device must have the same."""'
    for constant in schema["constant"]:
        yield f"{constant['name']} = {constant['value']}"
        yield f'"""{constant["doc"]}"""'
    for enum in [*schema["enum"], *schema["flags"]]:
        base = "IntEnum" if enum in schema["enum"] else "IntFlag"
        yield from ("", "", f"class {enum['name']}({base}):", f'    """{enum["doc"]}"""', "")
        for member in enum["members"]:
            value = member["value"] if base == "IntEnum" else f"0x{member['value']:04X}"
            yield f"    {member['name']} = {value}"
            yield f'    """{_sentence(member["doc"])}"""'
    for message in schema["message"]:
        yield from ("", "", f"class {message['name']}(NamedTuple):", f'    """{message["doc"]}"""')
        yield ""
        for field in (*HEADER, *message["fields"]):
            yield f"    {field['name']}: {'tuple[int, ...]' if 'count' in field else 'int'}"
            yield f'    """{_sentence(field_doc(field))}"""'
    yield ""
    yield ""
    names = [message["name"] for message in schema["message"]]
    yield "Message = ("
    yield from (f"    {'| ' if i else ''}{name}" for i, name in enumerate(names))
    yield ")"
    yield '"""Any message."""'
    yield ""
    yield "MESSAGES: dict[int, type[Message]] = {"
    yield from (f"    0x{m['type']:02X}: {m['name']}," for m in schema["message"])
    yield "}"
    yield '"""Class of each type."""'
    yield "TYPES: dict[type[Message], int] = {m: number for number, m in MESSAGES.items()}"
    yield '"""Type of each class."""'
    yield "LAYOUTS: dict[int, str] = {"
    for message in schema["message"]:
        yield f'    0x{message["type"]:02X}: "{_layout(message)}",'
    yield "}"
    yield '"""Layout of each type after its type byte, in the letters of the struct module."""'
    yield "ARRAYS: dict[int, int] = {"
    for message in schema["message"]:
        for field in message["fields"]:
            if "count" in field:
                yield f"    0x{message['type']:02X}: {field['count']},"
    yield "}"
    yield '"""Length of the array at the end of a type; types without an array are left out."""'


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _layout(message: Table) -> str:
    fields = (*HEADER, *message["fields"])
    return "".join(f"{f.get('count', '')}{PYTHON[f['type']]}" for f in fields)


def c_text(schema: Table) -> str:
    """Return the text of `rig_protocol.h`."""
    return "\n".join(_c_lines(schema)) + "\n"


def _c_lines(schema: Table) -> Iterator[str]:
    yield "// Messages of the wire; generated from schema.toml, not to be edited."
    yield "// A structure has the bytes of its frame before stuffing: packed, little-endian."
    yield "#ifndef RIG_PROTOCOL_H"
    yield "#define RIG_PROTOCOL_H"
    yield ""
    yield "#include <stdint.h>"
    yield ""
    yield f"#define RIG_VERSION {schema['version']}"
    yield f"#define RIG_SCHEMA_HASH 0x{schema_hash(schema):08X}UL"
    for constant in schema["constant"]:
        yield f"#define RIG_{constant['name']} {constant['value']}U // {constant['doc']}"
    for enum in [*schema["enum"], *schema["flags"]]:
        yield from ("", f"// {enum['doc']}", "enum {")
        for member in enum["members"]:
            name = f"RIG_{enum['name'].upper()}_{member['name']}"
            yield f"    {name} = 0x{member['value']:X}, // {member['doc']}"
        yield "};"
    for message in schema["message"]:
        name, length = wire_name(message), frame_length(message)
        struct = f"rig_{name.lower()}_t"
        yield from ("", f"// {message['doc']}", f"#define RIG_TYPE_{name} 0x{message['type']:02X}U")
        yield "typedef struct __attribute__((packed)) {"
        yield "    uint8_t type;"
        for field in (*HEADER, *message["fields"]):
            size = f"[{field['count']}]" if "count" in field else ""
            yield f"    {C[field['type']]} {field['name']}{size}; // {field_doc(field)}"
        yield "    uint32_t crc; // CRC-32/ISO-HDLC of all bytes before it"
        yield f"}} {struct};"
        yield f'_Static_assert(sizeof({struct}) == {length}, "{name}");'
        yield f'_Static_assert(sizeof({struct}) <= RIG_MAX_DECODED, "{name}");'
    yield ""
    yield "#endif"


def tables_text(schema: Table) -> str:
    """Return the tables of PROTOCOL.md."""
    return "\n".join(_table_lines(schema)) + "\n"


def _table_lines(schema: Table) -> Iterator[str]:
    yield f"Version {schema['version']}, schema hash `0x{schema_hash(schema):08X}`."
    yield from ("", "### Limits", "", "| name | value | meaning |", "|---|---|---|")
    for constant in schema["constant"]:
        yield f"| {constant['name']} | {constant['value']} | {constant['doc']} |"
    for enum in [*schema["enum"], *schema["flags"]]:
        yield from ("", f"### {enum['name']}", "", enum["doc"], "", "| name | value | meaning |")
        yield "|---|---|---|"
        for member in enum["members"]:
            value = member["value"] if enum in schema["enum"] else f"0x{member['value']:04X}"
            yield f"| {member['name']} | {value} | {member['doc']} |"
    for message in schema["message"]:
        length = frame_length(message)
        way = "host to device" if message["type"] < 0x80 else "device to host"
        yield from ("", f"### {wire_name(message)} 0x{message['type']:02X}", "")
        yield f"{message['doc']} From {way}, {length} B decoded, {length + 2} B on the wire."
        if message["fields"]:
            yield from ("", "| offset | type | field | meaning |", "|---|---|---|---|")
        at = 4
        for field in message["fields"]:
            count = field.get("count", 1)
            kind = field["type"] + (f"[{count}]" if count > 1 else "")
            yield f"| {at} | {kind} | {field['name']} | {field_doc(field)} |"
            at += SIZES[field["type"]] * count


def vector_lines(schema: Table) -> Iterator[str]:
    """Yield the golden vectors of the messages, one per line."""
    for message in schema["message"]:
        fields = [field["name"] for field in (*HEADER, *message["fields"])]
        yield from vectors_of(message["name"], message["type"], _layout(message), fields)


def file_texts(root: Path) -> dict[Path, str]:
    """Return, for each generated file below `root`, the text that the file must contain."""
    schema = tomllib.loads((root / "schema.toml").read_text(encoding="utf-8"))
    protocol, vectors = root / "PROTOCOL.md", root / "vectors" / "frames.json"
    before, tail = protocol.read_text(encoding="utf-8").split(BEGIN)
    after = tail.split(END)[1]
    return {
        root / "armrig_protocol" / "messages.py": python_text(schema),
        root / "firmware" / "rig_protocol.h": c_text(schema),
        protocol: f"{before}{BEGIN}\n{tables_text(schema)}{END}{after}",
        vectors: vectors_text(vectors.read_text(encoding="utf-8"), [*vector_lines(schema)]),
    }


def main(arguments: list[str], root: Path = ROOT) -> int:
    """Write the generated files; with `--check`, print the files that differ from the schema."""
    if arguments not in ([], ["--check"]):
        print(f"{' '.join(arguments)}: only --check is allowed", file=sys.stderr)
        return 2
    if not (root / "schema.toml").exists():
        print(f"{root}: no schema.toml; run this in a checkout of armrig", file=sys.stderr)
        return 2
    stale = {
        path: text
        for path, text in file_texts(root).items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    }
    for path, text in stale.items():
        if arguments:
            print(f"{path}: differs from schema.toml; run python -m armrig_protocol.generate")
        else:
            path.write_text(text, encoding="utf-8")
            print(f"{path}: written")
    return 1 if arguments and stale else 0


FILLINGS = ("zero", "ones", "mixed")


def vectors_of(name: str, number: int, layout: str, fields: Sequence[str]) -> Iterator[str]:
    """Yield a message's vectors, one per line.

    The vectors are made from the schema alone, not by the codec that they test.

    `layout` describes the bytes between the type and the CRC, in the letters of the struct module.
    The last of the `fields` takes all remaining values.
    """
    text = Struct("<" + layout)
    # The bytes depend on the name alone: a field added at the end changes no byte before it.
    mixed = shake_128(name.encode()).digest(text.size)
    raws = (bytes(text.size), b"\xff" * text.size, mixed)
    for filling, raw in zip(FILLINGS, raws, strict=True):
        values: list[Any] = list(text.unpack(raw))
        if len(values) > len(fields):
            values[len(fields) - 1 :] = [values[len(fields) - 1 :]]
        frame = bytes([number]) + raw
        wire = cobs.stuff(frame + crc32(frame).to_bytes(4, "little")) + b"\0"
        event = {"event": name, **dict(zip(fields, values, strict=True))}
        vector = {"doc": f"{name} {filling}", "wire": wire.hex(), "events": [event]}
        yield json.dumps(vector)


def is_generated(line: str) -> bool:
    """Return whether a line of the file is generated; all other lines are written by hand."""
    name, _, filling = json.loads(line)["doc"].partition(" ")
    return name.isidentifier() and filling in FILLINGS


def vectors_text(before: str, generated: Sequence[str]) -> str:
    """Return the text of the file: the lines written by hand, then the generated lines."""
    lines = [line.rstrip(",") for line in before.splitlines()[1:-1]]
    by_hand = [line for line in lines if not is_generated(line)]
    return "[\n" + ",\n".join([*by_hand, *generated]) + "\n]\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
