"""Exports of a recording: other programs read what was recorded."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pyarrow.parquet
import pytest
import scipy.io
from armrig.cli import main
from armrig.recordings.files import export
from armrig.recordings.files.export import write_csv, write_mat, write_parquet
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording, export_columns

from tests.clients.made_recordings import TS, gap, manifest, recorded, turning, written
from tests.tools import require

N = 300
NAMES = ["k", "t", "u", "theta_1", "alpha", "valid", "valid_alpha", "present"]


@pytest.fixture
def rec(tmp_path: Path) -> Recording:
    """Return a run with dead band and a gap, in a path with blanks and letters of all kinds."""
    folder = tmp_path / "Übung 3 – réglage"
    folder.mkdir()
    readings = [30_000 + 100 * (k % 300) if k % 50 else 0 for k in range(N)]
    samples = [s._replace(u_applied_v=0.1 + s.k / N) for s in turning(readings)]
    messages = [*samples[:100], gap(100, 5, 2.5), *samples[105:]]
    return load(written(folder, recorded(messages, manifest=manifest(k_first=0, samples=N))))


def test_an_exported_csv_is_read_back_exactly(rec: Recording) -> None:
    path = rec.path.with_name("daten für alle.csv")
    write_csv(rec, path, raw=True)

    table = np.genfromtxt(path, delimiter=",", names=True)
    for name in ("t", "u", "theta_1", "alpha"):
        np.testing.assert_array_equal(table[name], getattr(rec, name))
    np.testing.assert_array_equal(table["valid"], rec.valid)
    np.testing.assert_array_equal(table["flags"][rec.present], rec.samples["flags"])
    data = armrig.load_data(path, signal="theta_1")
    other = path.with_name("excel.csv")
    text = path.read_text(encoding="utf-8").replace(",", ";").replace("\n", "\r\n")
    other.write_bytes(text.encode())
    for found in (data, armrig.load_data(other, signal="theta_1")):
        assert pytest.approx(TS) == found.Ts
        np.testing.assert_array_equal(found.y, rec.theta_1)
        np.testing.assert_array_equal(found.u, rec.u)


def test_a_part_keeps_its_numbers_in_every_file(rec: Recording) -> None:
    """The number k is that of the whole run, so that a part can be joined to the rest."""
    part = load(rec.path, start=2.0)
    csv, mat, parquet = (rec.path.with_name(f"part.{kind}") for kind in ("csv", "mat", "parquet"))
    write_csv(part, csv)
    write_mat(part, mat)
    write_parquet(part, parquet)

    found = {
        "csv": np.genfromtxt(csv, delimiter=",", names=True)["k"],
        "mat": scipy.io.loadmat(mat)["k"].ravel(),
        "parquet": pyarrow.parquet.read_table(parquet)["k"].to_numpy(),
        "pandas": part.to_pandas()["k"].to_numpy(),
        "xarray": part.to_xarray()["k"].to_numpy(),
    }

    for kind, k in found.items():
        np.testing.assert_array_equal(k, np.arange(200, N), err_msg=kind)


def test_an_export_has_a_column_for_the_validity_of_each_angle(rec: Recording) -> None:
    found = export_columns(rec)

    hidden = np.arange(N) % 50 == 0
    missing = (np.arange(N) >= 100) & (np.arange(N) < 105)
    np.testing.assert_array_equal(found["present"], ~missing)
    np.testing.assert_array_equal(found["valid_alpha"], ~missing)
    assert not found["valid"][hidden | missing].any()


@pytest.mark.parametrize("raw", [False, True])
def test_raw_readings_are_exported_on_request(rec: Recording, raw: bool) -> None:
    mat, parquet = (rec.path.with_name(f"raw.{kind}") for kind in ("mat", "parquet"))
    write_mat(rec, mat, raw=raw)
    write_parquet(rec, parquet, raw=raw)

    variables, table = scipy.io.loadmat(mat), pyarrow.parquet.read_table(parquet)

    assert ("theta_1_counts" in variables) is raw
    assert ("theta_1_counts" in table.column_names) is raw
    if raw:
        counts = np.zeros(N)
        counts[rec.present] = rec.samples["theta_1_counts"]
        np.testing.assert_array_equal(variables["theta_1_counts"].ravel(), counts)
        np.testing.assert_array_equal(table["theta_1_counts"].to_numpy(), counts)


def test_an_exported_file_names_run_output_and_sampling_time(rec: Recording) -> None:
    path = rec.path.with_name("alpha.mat")
    write_mat(rec, path, output="alpha")

    found, about = scipy.io.loadmat(path), rec.to_pandas().attrs

    assert (found["output"].item(), found["run_id"].item()) == ("alpha", rec.manifest.run_id)
    assert (about["run_id"], about["rig"]) == (rec.manifest.run_id, rec.manifest.rig)
    assert float(about["Ts"]) == found["Ts"].item() == TS
    units = {name: about[f"unit_{name}"] for name in ("t", "u", "theta_1", "alpha")}
    assert units == {"t": "s", "u": "V", "theta_1": "rad", "alpha": "rad"}


def test_a_long_recording_is_written_row_by_row_as_a_short_one(
    rec: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, many = rec.path.with_name("one.csv"), rec.path.with_name("many.csv")
    write_csv(rec, one)
    monkeypatch.setattr(export, "_BLOCK_ROWS", 70)
    write_csv(rec, many)

    assert len(one.read_text().splitlines()) == 1 + N
    assert many.read_text() == one.read_text()


@pytest.mark.parametrize("kind", ["csv", "mat", "parquet"])
def test_a_failed_export_leaves_no_file(
    rec: Recording, kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half a file would look like a complete one."""
    out = rec.path.with_name(f"out.{kind}")

    def full(recording: Recording, path: Path, **_: Any) -> None:
        path.write_bytes(b"k,t,u")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(f"armrig.recordings.files.export.write_{kind}", full)

    assert main(["export", str(rec.path), str(out)]) == 1

    assert f"{out}: No space left on device" in capsys.readouterr().err
    assert not out.exists()


def _octave(program: str) -> list[str]:
    """Return the words that an Octave program prints."""
    require("octave-cli")
    told = subprocess.run(
        ["octave-cli", "--no-gui", "--quiet", "--norc", "--eval", program],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert told.returncode == 0, told.stderr
    return told.stdout.split()


def test_octave_reads_the_mat_file(rec: Recording) -> None:
    path = rec.path.with_name("run.mat")
    write_mat(rec, path)

    Ts, total, unknown, seventh, digest = _octave(f"""
        load("{path}");
        assert(isa(y, "double") && isa(u, "double") && islogical(valid));
        assert(size(u), [{N}, 1]); assert(size(y), [{N}, 1]);
        assert(isequaln(y, theta_1));
        printf("%.17g %.17g %d %.17g %s\\n", Ts, sum(u), sum(isnan(y)), y(7), sha256);
    """)

    assert float(Ts) == TS
    assert float(total) == pytest.approx(rec.u.sum(), rel=1e-14)
    assert int(unknown) == np.count_nonzero(np.isnan(rec.theta_1))
    assert float(seventh) == rec.theta_1[6]
    assert digest == rec.sha256


def test_octave_s_iddata_accepts_the_mat_file_unchanged(rec: Recording) -> None:
    path = rec.path.with_name("run.mat")
    write_mat(rec, path, output="alpha")

    if _octave("disp(isempty(pkg('list', 'control')))") == ["1"]:
        pytest.skip("no control package of Octave: apt install octave-control")
    n, m, p, tsam, first = _octave(f"""
        pkg load control
        load("{path}");
        z = iddata(y, u, Ts);
        [n, p, m] = size(z);
        model = arx(iddata(y(106:end), u(106:end), Ts), 1);
        printf("%d %d %d %.17g %.17g\\n", n, m, p, z.tsam{{1}}, z.u{{1}}(1));
    """)

    assert (int(n), int(m), int(p)) == (N, 1, 1)
    assert float(tsam) == TS
    assert float(first) == rec.u[0]


def test_pandas_xarray_and_parquet_have_the_same_columns(rec: Recording) -> None:
    frame, data, path = rec.to_pandas(), rec.to_xarray(), rec.path.with_name("run.parquet")
    write_parquet(rec, path)
    table = pyarrow.parquet.read_table(path)

    assert list(frame.columns) == [n for n in NAMES if n != "t"]
    np.testing.assert_array_equal(frame.index, rec.t)
    np.testing.assert_array_equal(frame["alpha"], rec.alpha)
    units = {name: data[name].attrs.get("units") for name in NAMES}
    assert units == {
        **dict.fromkeys(NAMES),
        **{"t": "s", "u": "V", "theta_1": "rad", "alpha": "rad"},
    }
    np.testing.assert_array_equal(data["u"], rec.u)
    assert frame.attrs["sha256"] == data.attrs["sha256"] == rec.sha256
    assert table.column_names == NAMES
    for name in ("theta_1", "valid"):
        np.testing.assert_array_equal(table[name].to_numpy(), getattr(rec, name))
    about = table.schema.metadata
    assert (about[b"sha256"].decode(), about[b"unit_theta_1"]) == (rec.sha256, b"rad")


@pytest.mark.parametrize(
    ("package", "extra", "export"),
    [
        ("pandas", "pandas", Recording.to_pandas),
        ("xarray", "xarray", Recording.to_xarray),
        ("pyarrow", "parquet", lambda rec: write_parquet(rec, rec.path.with_name("x.parquet"))),
    ],
)
def test_a_missing_package_is_reported_with_the_remedy(
    rec: Recording,
    package: str,
    extra: str,
    export: Callable[[Recording], object],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    for kind in (ImportError, ValueError):
        with pytest.raises(kind, match=rf"pip install {package}, .* 'armrig\[{extra}\]'$"):
            export(rec)
