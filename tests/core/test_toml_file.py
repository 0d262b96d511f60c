"""A TOML file of any origin is read, or refused in a line."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import pytest
from armrig_core.errors import FileError
from armrig_core.process.toml_file import read_toml, toml_tables


@pytest.mark.parametrize(
    "text",
    [
        "a." * 32_000 + "a = 1",
        "[" + "a." * 32_000 + "a]",
        '"a" . ' * 12_000 + "b = 1",
        "x = {" + "'a'." * 16_000 + "b = 1}",
        "x = " + "[" * 30_000,
        "x = " + "{a = " * 12_000,
        '"\\"".' * 10_000 + "b = 1",
        "x = " + "{a.a.a.a.a.a.a.a = " * 50 + "1" + "}" * 50,
    ],
    ids=["dots", "a table", "quoted", "inline", "lists", "tables", "escaped", "both"],
)
def test_deeply_nested_toml_is_refused_at_once(text: str) -> None:
    """The reader's time would grow with the square of the depth: 18 s for a file."""
    with pytest.raises(FileError, match="nested too deeply"):
        toml_tables(text)


def test_a_long_word_is_read_at_once() -> None:
    """The search for deep keys began at each character: 45 s for a name in 64 KiB."""
    begun = process_time()

    toml_tables("x = '" + "a" * 60_000 + "'")

    assert process_time() - begun < 5  # 0.02 s


def test_a_key_of_sixteen_parts_is_read() -> None:
    parts = [f"k{i}" for i in range(16)]
    tables = toml_tables(f"{'.'.join(parts)} = 1.5\ntext = '{'. ' * 40}'  # {'.' * 40}")

    for part in parts[:-1]:
        tables = tables[part]
    assert tables == {"k15": 1.5}


@pytest.mark.parametrize("begin", ["", "a = 1\n", "a = {"])
def test_a_key_of_seventeen_parts_is_refused_at_any_place(begin: str) -> None:
    key = ".".join(f'"k {i}"' if i % 2 else f"k{i}" for i in range(17))

    with pytest.raises(FileError, match="nested too deeply: a key has at most 16 parts"):
        toml_tables(f"{begin}{key} = 1{'}' if '{' in begin else ''}")


def test_tables_of_sixty_four_levels_are_read() -> None:
    def nested(levels: int) -> str:
        return "x = " + "[" * (levels - 1) + "]" * (levels - 1)

    assert "x" in toml_tables(nested(64))
    with pytest.raises(FileError, match="nested too deeply: at most 64 levels are read"):
        toml_tables(nested(65))


def test_a_file_is_refused_with_the_message_of_the_reader(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("a = ")
    with pytest.raises(FileError, match=r"not a TOML file: Invalid value \(at end of document\)"):
        read_toml(path, 100)
