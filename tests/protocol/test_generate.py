"""The generated files agree with the schema, in Python and in C."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from armrig_protocol.generate import ROOT, file_texts, main
from armrig_protocol.messages import SCHEMA_HASH, VERSION

CC = ("cc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic")


def _copy(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "schema.toml", tmp_path)
    shutil.copy(ROOT / "PROTOCOL.md", tmp_path)
    shutil.copytree(ROOT / "vectors", tmp_path / "vectors")
    return tmp_path


def _generated_python(root: Path) -> str:
    return file_texts(root)[root / "armrig_protocol" / "messages.py"]


def test_the_generated_files_match_the_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--check"]) == 0
    assert capsys.readouterr().out == ""


def test_the_schema_hash_depends_on_fields_and_not_on_descriptions(tmp_path: Path) -> None:
    root = _copy(tmp_path)
    schema = (root / "schema.toml").read_text()
    ours = f"SCHEMA_HASH = 0x{SCHEMA_HASH:08X}"

    (root / "schema.toml").write_text(schema.replace("Ask for the identity", "Who is it"))
    assert ours in _generated_python(root)

    (root / "schema.toml").write_text(
        schema.replace('"host_ns", type = "u64"', '"host_ns", type = "u32"')
    )
    assert ours not in _generated_python(root)


def test_an_added_field_changes_only_the_vectors_of_its_message(tmp_path: Path) -> None:
    root = _copy(tmp_path)
    vectors = root / "vectors" / "frames.json"
    before = vectors.read_text().splitlines()
    schema = (root / "schema.toml").read_text()
    field = '{ name = "host_ns", type = "u64", unit = "ns", doc = "value of host_ns in PING" },'
    assert schema.count(field) == 1

    (root / "schema.toml").write_text(
        schema.replace(field, field + '\n  { name = "more", type = "u8", doc = "more" },')
    )
    after = file_texts(root)[vectors].splitlines()

    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    docs = [json.loads(b.rstrip(","))["doc"] for _, b in changed]
    assert docs == ["Pong zero", "Pong ones", "Pong mixed"]
    old, new = (json.loads(line.rstrip(","))["events"][0] for line in changed[-1])
    assert (new["state"], new["seq"], new["host_ns"]) == (old["state"], old["seq"], old["host_ns"])
    assert "more" in new


def test_an_unknown_argument_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--chekc"]) == 2
    assert "--chekc: only --check is allowed" in capsys.readouterr().err


def test_the_generated_header_compiles_and_its_sizes_are_correct(tmp_path: Path) -> None:
    source = tmp_path / "header.c"
    main_c = f"int main(void) {{ return RIG_VERSION - {VERSION}; }}"
    source.write_text(f'#include "rig_protocol.h"\n{main_c}\n')

    result = subprocess.run(
        [*CC, f"-I{ROOT / 'firmware'}", str(source), "-o", str(tmp_path / "header")],
        capture_output=True,
        text=True,
        check=False,
    )

    assert result.returncode == 0, result.stderr
    asserts = re.findall(
        r"sizeof\((\w+)\) == (\d+)", (ROOT / "firmware/rig_protocol.h").read_text()
    )
    assert ("rig_sample_t", "34") in asserts
    assert ("rig_setpoints_t", "62") in asserts


def test_a_file_that_differs_from_the_schema_is_reported_and_regenerated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = _copy(tmp_path)
    for path in ("armrig_protocol/messages.py", "firmware/rig_protocol.h"):
        (root / path).parent.mkdir()
        shutil.copy(ROOT / path, root / path)
    header = root / "firmware" / "rig_protocol.h"
    sound = header.read_text()
    header.write_text(sound + "\n")
    (root / "armrig_protocol" / "messages.py").unlink()

    codes = [main(arguments, root) for arguments in (["--check"], [], ["--check"], [])]

    assert codes == [1, 0, 0, 0]
    said = [line.removeprefix(f"{root}/") for line in capsys.readouterr().out.splitlines()]
    differs = "differs from schema.toml; run python -m armrig_protocol.generate"
    assert said == [
        f"armrig_protocol/messages.py: {differs}",
        f"firmware/rig_protocol.h: {differs}",
        "armrig_protocol/messages.py: written",
        "firmware/rig_protocol.h: written",
    ]
    assert header.read_text() == sound


def test_files_are_generated_only_in_a_checkout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([], tmp_path) == 2
    assert f"{tmp_path}: no schema.toml; run this in a checkout" in capsys.readouterr().err
