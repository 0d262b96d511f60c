"""`armrig import`: foreign data become a recording that every other command reads."""

from __future__ import annotations

import json
import re
import shlex
from hashlib import sha256
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.data.files import loading
from armrig.data.files.imported_file import ImportedData, read_imported, write_imported
from armrig.recordings.files import imports
from armrig.recordings.files.imports import load_import, name_of_import
from armrig_core.errors import FileError
from armrig_core.recording_file.manifest import OUTCOME
from msgspec.structs import replace

N = 400


def _rows(seed: int = 1) -> list[tuple[float, float]]:
    """Return the power and the temperature of a heater: 0.2 / (q - 0.9)."""
    rng, y, rows = np.random.default_rng(seed), 0.0, []
    u = 1.0
    for _ in range(N):
        u = 4.0 - u if rng.random() < 0.1 else u
        rows.append((u, 20 + y + 0.02 * rng.standard_normal()))
        y = 0.9 * y + 0.2 * u
    return rows


HEADING = "time [s],power [W],temp [°C]"


def _csv(path: Path, *, names: str = HEADING, seed: int = 1) -> Path:
    lines = [f"{0.5 * k:.1f},{u:.0f},{y:.4f}" for k, (u, y) in enumerate(_rows(seed))]
    path.write_text("\n".join([names, *lines]) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def lamp(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Path:
    """Import files of heaters as @lamp, @again and @price; give the first import."""
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path / "recordings"))
    monkeypatch.chdir(tmp_path)
    for name, seed in (("lamp", 1), ("again", 2), ("price", 3)):
        names = "time [s],power [$],temp [$/h]" if name == "price" else HEADING
        file = _csv(Path(f"{name}.csv"), names=names, seed=seed)
        assert main(["import", str(file), "--input", "power", "--signal", "temp"]) == 0
    capsys.readouterr()
    [path] = (tmp_path / "recordings").glob("imported-lamp-*.mcap")
    return path


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("info @lamp", "from       lamp.csv"),
        ("plot @lamp -o plot.png", ""),
        ("ls", "@lamp"),
        ("verify @lamp", "complete, 400 rows as imported"),
        ("export @lamp out.csv", "out.csv: 400 samples"),
        ("export @lamp out.mat", "out.mat"),
        ("sampling @lamp", "sampling time"),
        ("hints @lamp", "structure hints: begin with"),
        ("identify @lamp --structure oe --nb 1 --nf 1 --offset --save m.json", "fits temp to 98"),
        ("check @lamp --detrend", "open loop"),
        ("linearity @lamp", "no nonlinearity found"),
        ("report @lamp @again -o report.pdf", "report.pdf"),
        ("report @price -o price.pdf", "price.pdf"),
        ("plot @price -o price.png", ""),
        ("compare @lamp @again", "simulated on @again"),
        ("batch verify recordings -o table.parquet", "table.parquet: 3 recordings"),
    ],
)
def test_every_command_reads_imported_data(
    lamp: Path, command: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shlex.split(command)) == 0

    shown = capsys.readouterr()
    assert said in shown.out
    assert "internal error" not in shown.err


def test_a_model_of_imported_data_is_validated_on_other_imported_data(
    lamp: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(shlex.split("identify @lamp --structure oe --nb 1 --nf 1 --offset --save m.json")) == 0
    )
    assert main(shlex.split("validate @again --model m.json")) == 0

    assert "Its residuals pass" in capsys.readouterr().out


EQUATIONS = """
import armrig
model = armrig.Ode(
    lambda t, x, u, p: [(p.K * u[0] - x[0]) / p.T],
    output=lambda t, x, u, p: x[0] + p.T_0,
    states=["rise"],
    parameters={name: armrig.Parameter(value) for name, value in (("K", 1), ("T", 3), ("T_0", 18))},
)
"""


def test_own_equations_are_estimated_from_imported_data(
    lamp: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The truth is K = 2 and T = 0.5 s / -ln 0.9 = 4.746 s."""
    Path("heater.py").write_text(EQUATIONS)
    options = "--model heater.py --validate @again"

    assert main(["greybox", "@lamp", *options.split()]) == 0
    assert "Simulated on @again, it fits temp to 98" in capsys.readouterr().out
    assert main(["greybox", "@lamp", *options.split(), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    for name, truth in (("K", 2.0), ("T", 4.746)):
        estimate = facts["parameters"][name]
        assert abs(estimate["value"] - truth) < 4 * estimate["std"]
    assert facts["data"] == sha256(lamp.read_bytes()).hexdigest()


def test_the_arm_s_model_is_refused_for_imported_data(
    lamp: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["greybox", "@lamp", "--model", "arm"]) == 1

    assert "`armrig greybox F --model FILE.py`" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", ["replay @lamp", "play @lamp", "split @lamp", "report --handout @lamp -o h.pdf"]
)
def test_a_command_that_needs_a_rig_refuses_imported_data_in_a_sentence(
    lamp: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shlex.split(command)) == 1

    [line] = [x for x in capsys.readouterr().err.splitlines() if x.startswith("armrig: ")]
    assert re.search("imported|of the rig", line)


def test_an_import_keeps_the_numbers_units_and_hash_of_the_file(lamp: Path) -> None:
    import hashlib

    data = load_import(lamp)
    assert data is not None
    read = armrig.load_data(lamp, input="power", signal="temp")
    directly = armrig.load_data("lamp.csv", input="power", signal="temp")

    assert np.array_equal(read.u, directly.u)
    assert np.array_equal(read.y, directly.y)
    assert (read.Ts, read.unit, read.input_unit) == (0.5, "°C", "W")
    assert data.facts.sources[0].sha256 == hashlib.sha256(Path("lamp.csv").read_bytes()).hexdigest()
    assert name_of_import(data.facts.sources[0].sha256) == "@lamp"


def test_missing_rows_and_breaks_are_those_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path / "recordings"))
    lines = _csv(tmp_path / "gaps.csv", names="t,u,y").read_text(encoding="utf-8").splitlines()
    # A missing value, two rows that are left out, and a pause of 50 s.
    lines[20] = lines[20].rpartition(",")[0] + ","
    kept = [*lines[:50], *lines[52:100], *lines[200:]]
    (tmp_path / "gaps.csv").write_text("\n".join(kept) + "\n")
    assert main(["import", str(tmp_path / "gaps.csv"), "-o", str(tmp_path / "gaps.mcap")]) == 0

    of_import, of_file = (armrig.load_data(tmp_path / f"gaps.{x}") for x in ("mcap", "csv"))

    assert of_import.starts == of_file.starts
    assert np.array_equal(of_import.valid, of_file.valid)
    assert np.array_equal(of_import.y, of_file.y, equal_nan=True)


def test_a_file_that_needs_an_option_is_refused_with_a_line_that_works(
    lamp: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{k},{u if k % 7 == 0 else ''},{y:.4f}" for k, (u, y) in enumerate(_rows())]
    Path("held.csv").write_text("\n".join(["t [s],u,y", *rows]) + "\n")
    assert main(["hints", "held.csv"]) == 1
    [line] = re.findall("`armrig (import .*?)`", capsys.readouterr().err)

    assert main(shlex.split(line)) == 0
    assert main(["hints", "@held"]) == 0
    capsys.readouterr()
    assert main(["hints", "held.csv"]) == 1
    assert "held.csv was imported as @held: use @held" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--name lamp", "@lamp is already a complete recording"),
        ("--name LAMP", "at most 31 of a-z, 0-9 and - are allowed"),
        ("-o lamp.csv", "would be overwritten"),
        ("--unwrap 360", "--unwrap needs --signal NAME"),
        ("--resample", "--resample needs --input NAME"),
        ("--input power --signal power2", "there is no such column"),
        ("--Ts nan", "must be finite"),
    ],
)
def test_a_wrong_option_is_refused_before_anything_is_written(
    lamp: Path, options: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(lamp.parent.iterdir())

    assert main(["import", "lamp.csv", *shlex.split(options)]) == 1

    assert said in capsys.readouterr().err
    assert sorted(lamp.parent.iterdir()) == before


@pytest.mark.parametrize("at", [0.2, 0.5, 0.9])
def test_a_changed_file_is_refused(
    lamp: Path, at: float, capsys: pytest.CaptureFixture[str]
) -> None:
    content = bytearray(lamp.read_bytes())
    content[int(at * len(content))] ^= 0x55
    lamp.write_bytes(content)

    assert main(["hints", str(lamp), "--input", "power", "--signal", "temp"]) == 1

    assert "internal error" not in capsys.readouterr().err


def test_a_changed_value_is_found_by_the_hash(lamp: Path) -> None:
    data = load_import(lamp)
    assert data is not None
    values = data.values.copy()
    values[3, 1] += 1e-9
    forged = ImportedData(facts=data.facts, Ts=data.Ts, at=data.at, size=data.size, values=values)

    assert forged.sha256 != data.sha256
    _, content = write_imported(data, name="x", started="", armrig="0")
    again = read_imported(content)
    assert again is not None
    assert replace(again.facts, values_sha256="") == replace(data.facts, values_sha256="")


def test_the_facts_are_printed_as_json(lamp: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "@lamp", "--json"]) == 0

    facts = json.loads(capsys.readouterr().out)
    assert facts["import"]["columns"] == [
        {"name": "power", "unit": "W"},
        {"name": "temp", "unit": "°C"},
    ]
    assert (facts["Ts"], facts["samples"], facts["missing"]) == (0.5, N, 0)


def test_a_column_without_a_name_is_named_by_its_number_in_the_file(
    lamp: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A refusal lists the columns by number and name, and both serve."""
    lines = (tmp_path / "lamp.csv").read_text(encoding="utf-8").splitlines()[1:]
    Path("plain.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    command = ["identify", "@plain", "--structure", "oe", "--nb", "1", "--nf", "1"]
    assert main(["import", "plain.csv", "--time", "1"]) == 0

    assert main([*command, "--input", "u", "--signal", "y"]) == 1
    assert "1 column_2, 2 column_3" in capsys.readouterr().err
    for u, y in (("1", "2"), ("column_2", "column_3")):
        assert main([*command, "--input", u, "--signal", y]) == 0
        assert "column_2 to column_3" in capsys.readouterr().out


def test_an_import_without_an_outcome_is_reported_as_damaged(
    lamp: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = imports.read_metadata
    monkeypatch.setattr(
        imports,
        "read_metadata",
        lambda path: {name: x for name, x in whole(path).items() if name != OUTCOME},
    )

    assert main(["report", str(lamp), "-o", "lamp.pdf"]) == 1
    assert "is damaged (it has no outcome)" in capsys.readouterr().err


def test_a_recording_too_large_to_be_read_is_not_written(
    lamp: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(lamp.parent.iterdir())
    monkeypatch.setattr(loading, "MOST_BYTES", 1000)

    assert main(["import", "lamp.csv", "--name", "large"]) == 1

    assert "name the columns that you need" in capsys.readouterr().err
    assert sorted(lamp.parent.iterdir()) == before


def test_python_says_how_a_recording_of_unknown_columns_is_read(
    lamp: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", "lamp.csv", "--name", "open"]) == 0

    with pytest.raises(FileError, match="which of power and temp are the input and the one or two"):
        armrig.load("@open")
    with pytest.raises(FileError, match=r"is the name of a recording: use armrig.load\('@lamp'\)"):
        armrig.load_data("@lamp")
