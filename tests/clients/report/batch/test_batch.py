"""One task for all recordings of a folder: a row for each, even if workers die."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import signal
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import msgspec
import numpy as np
import pytest
from armrig.cli import main
from armrig.models.model_writing import model_text
from armrig.recordings.files.verification import RESULTS, verify
from armrig.report.batch import workers
from armrig.report.batch.batch import SUFFIX, Progress, batch, header_of, results, still_right
from armrig.report.batch.tasks import (
    OF_THE_FILE,
    OF_THE_RESULT,
    OF_THE_RUN,
    OF_THE_TASK,
    Identify,
    Item,
    Report,
    Task,
    Validate,
    Verify,
    columns_of,
    items_in,
    name_of,
    row_of,
)
from armrig.report.study import Orders
from armrig_core.errors import FileError, OperationError

from tests.clients import made_recordings
from tests.clients.batches import SHORT, kept, started, telegraph, wait_for_rows
from tests.clients.deadly import deadly
from tests.clients.odd_recording import ODD, odd_recording

pyarrow_parquet = pytest.importorskip("pyarrow.parquet")
ARX = Identify(structure="arx", orders={"na": 4, "nb": 4})
report = partial(Report, na=4, nb=4, nf=4, nk=1)
MANY = 36
OTHER_RIG, BROKEN, CUT, STEP = "m-other-rig.mcap", "m-broken.mcap", "m-cut.mcap", "m-step.mcap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return forty recordings of a typical lab."""
    made = tmp_path_factory.mktemp("recordings")
    for n in range(MANY):
        (made / f"a-{n:02}.mcap").write_bytes(made_recordings.of_the_arm(telegraph(n), seed=n))
    (made / BROKEN).write_bytes(b"no recording at all")
    in_chunks = made_recordings.of_the_arm(telegraph(1, 3000))
    (made / CUT).write_bytes(in_chunks[: len(in_chunks) * 3 // 4])
    of_another = made_recordings.of_the_arm(telegraph(1), rig="2")
    (made / OTHER_RIG).write_bytes(of_another)
    (made / STEP).write_bytes(made_recordings.of_the_arm(np.full(SHORT, 2.0), experiment="step"))
    return made


def done(folder: Path, task: Task, table: Path, **options: Any) -> list[dict[str, Any]]:
    """Do a task and return the table's rows; in one thread, where nothing is killed."""
    batch(folder, task, table, open_executor=partial(ThreadPoolExecutor, 1), at_once=4, **options)
    return rows_of(table)


def few_of(folder: Path, tmp_path: Path, *names: str) -> Path:
    """Return a folder with copies of these recordings."""
    few = tmp_path / "few"
    few.mkdir()
    for name in names:
        shutil.copy2(folder / name, few)
    return few


def computed(folder: Path, task: Task, table: Path, **options: Any) -> list[str]:
    """Return the recordings that a batch processes, which are not those that it keeps."""
    names: list[str] = []
    done(folder, task, table, count=lambda n, total, name: names.append(name), **options)
    return names


def rows_of(table: Path) -> list[dict[str, Any]]:
    """Return what another program reads."""
    with table.open("rb") as file:
        rows: list[dict[str, Any]] = pyarrow_parquet.read_table(file).to_pylist()
    return rows


@pytest.fixture(scope="module")
def identified(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the table of a batch that nothing has disturbed."""
    table = tmp_path_factory.mktemp("undisturbed") / "models.parquet"
    done(folder, ARX, table)
    return table


def test_each_recording_has_a_row_and_a_damaged_one_does_not_stop_the_batch(
    identified: Path,
) -> None:
    rows = {row["recording"]: row for row in rows_of(identified)}
    assert len(rows) == MANY + 4
    assert [name for name, row in rows.items() if row["problem"]] == [BROKEN, STEP]
    assert "is not a recording of the rig" in rows[BROKEN]["problem"]
    assert "\n" not in rows[BROKEN]["problem"]
    assert rows[CUT]["damage"]
    assert 0 < rows[CUT]["samples"] < 3000


def test_a_recording_too_short_for_its_orders_has_no_model(tmp_path: Path) -> None:
    (tmp_path / "short.mcap").write_bytes(made_recordings.of_the_arm(telegraph(1, 30)))

    [row] = done(tmp_path, ARX, tmp_path / "models.parquet")

    assert row["problem"].startswith("na=4, nb=4: 8 parameters from ")
    assert row["model"] is None


def test_each_figure_of_a_row_is_that_of_its_model(folder: Path, identified: Path) -> None:
    recording, other = (armrig.load(folder / f"a-0{n}.mcap") for n in (7, 8))
    fit = armrig.arx(recording.dataset(), na=4, nb=4)
    row = next(row for row in rows_of(identified) if row["recording"] == "a-07.mcap")
    names = ("fit_percent", "noise_variance", "loss", "fpe", "N", "output")
    assert {name: row[name] for name in names} == {name: getattr(fit, name) for name in names}
    assert row["converged"] == fit.search.converged
    assert row["p_white"] == fit.whiteness
    assert row["std_robust"] == fit.std_robust.tolist()
    assert row["parameters"] == fit.theta.tolist()
    assert (row["model"], row["sha256"]) == (model_text(fit), recording.sha256)
    item = next(item for item in items_in(folder) if item.name == "a-08.mcap")

    judged = row_of(Validate(model=model_text(fit)), item)

    compared = armrig.compare(other.dataset(), fit)[0]
    tests = armrig.residuals(fit, other.dataset())
    names = ("fit_percent", "rms_error", "velocity_fit_percent", "on_estimation_data")
    assert {name: judged[name] for name in names} == {n: getattr(compared, n) for n in names}
    assert judged["p_white"] == tests.white.p_value
    assert judged["p_no_dynamics_missing"] == tests.missing_dynamics
    assert judged["p_no_feedback"] == tests.feedback
    assert judged["model_of"] == recording.sha256


def test_a_header_contains_the_choice_and_the_options(folder: Path) -> None:
    header = header_of(ARX, folder, ["2", "1"], ["step", "bla"])

    assert (header["rigs"], header["kinds"]) == ("1 2", "bla step")
    assert header["folder"] == str(folder.resolve())
    assert json.loads(header["options"]) == msgspec.to_builtins(ARX)


def test_a_batch_selects_recordings_by_rig_and_experiment(folder: Path) -> None:
    assert [item.name for item in items_in(folder, rigs=["2"])] == [OTHER_RIG]
    assert [item.name for item in items_in(folder, kinds=["step"])] == [STEP]
    assert [item.name for item in items_in(folder, rigs=["1", "2"], kinds=["step"])] == [STEP]
    assert items_in(folder, rigs=["2"], kinds=["step"]) == []
    names = {item.name for item in items_in(folder, rigs=["1"])}
    assert not names & {OTHER_RIG, BROKEN, CUT}


def test_a_row_of_verify_has_the_checks_of_its_recording(folder: Path, tmp_path: Path) -> None:
    rows = {r["recording"]: r for r in done(folder, Verify(), tmp_path / "v.parquet")}
    for name in ("a-03.mcap", CUT):
        alone = verify(folder / name)
        assert rows[name]["passed"] is alone.passed
        assert {c.about: RESULTS[c.level] for c in alone.checks} == {
            c.about: rows[name][f"{c.about}_result"] for c in alone.checks
        }
        assert [rows[name][f"{c.about}_found"] for c in alone.checks] == [
            c.text for c in alone.checks
        ]
        assert rows[name]["samples"] == armrig.load(folder / name).samples.size


@pytest.mark.parametrize("task", [ARX, Validate(model=""), Verify(), report(folder="")])
def test_no_two_columns_have_one_name(task: Task) -> None:
    of_all = {*OF_THE_FILE, *OF_THE_RUN, *OF_THE_RESULT}
    assert not of_all & OF_THE_TASK[name_of(task)].keys()


def test_a_missing_report_is_written_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, made = report(folder=str(tmp_path)), []

    def row(task: Report, item: Item) -> dict[str, Any]:
        path = Path(task.folder, item.name).with_suffix(".pdf")
        path.write_bytes(b"%PDF-")
        made.append(item.name)
        known = {"recording": item.name, "bytes": item.bytes, "modified_ns": item.modified_ns}
        told = {"problem": "", "doubts": [], "report": path.name, "validated_by": ""}
        return dict.fromkeys(columns_of(task)) | known | told

    monkeypatch.setattr("armrig.report.batch.batch.row_of", row)
    few = few_of(folder, tmp_path, "a-00.mcap", "a-01.mcap")
    done(few, task, tmp_path / "reports.parquet")
    (tmp_path / "a-01.pdf").unlink()

    rows = done(few, task, tmp_path / "reports.parquet")

    assert made == ["a-00.mcap", "a-01.mcap", "a-01.mcap"]
    assert [row["report"] for row in rows] == ["a-00.pdf", "a-01.pdf"]


def test_a_report_has_its_orders_and_the_findings_on_both_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / name for name in ("short.mcap", "other.mcap")]
    for path, rig in zip(paths, "12", strict=True):
        path.write_bytes(made_recordings.of_the_arm(telegraph(1, 40), rig=rig))
    given: dict[str, Any] = {}

    def studied(recordings: Any, *, orders: Any) -> Any:
        given.update(recordings=[r.path for r in recordings], orders=orders)
        return SimpleNamespace(
            best=SimpleNamespace(name="OE", comparison=SimpleNamespace(rms_error=0.5))
        )

    def written(study: Any, path: Path) -> Path:
        path.write_bytes(b"a report")
        return path

    for name, fake in (("study.study", studied), ("document.report", written)):
        monkeypatch.setattr(f"armrig.report.{name}", fake)
    item = Item("short.mcap", str(paths[0]), bytes=1, modified_ns=2, validation=str(paths[1]))

    row = row_of(Report(folder=str(tmp_path / "r"), na=1, nb=2, nf=3, nk=4), item)

    assert given == {"recordings": paths, "orders": Orders(na=1, nb=2, nf=3, nk=4)}
    assert (row["problem"], row["report"], row["validated_by"]) == ("", "short.pdf", "other.mcap")
    assert row["report_sha256"] == hashlib.sha256(b"a report").hexdigest()
    assert (row["best"], row["rms_error"]) == ("OE", 0.5)
    few, two_rigs = row["doubts"]
    assert few.startswith("short.mcap has 40 samples")
    assert two_rigs.startswith("short.mcap is of rig 1 (device 0001), other.mcap of rig 2")


def test_a_row_has_the_facts_of_its_run(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    path.write_bytes(odd_recording())
    item = Item("odd.mcap", str(path), bytes=11, modified_ns=12, validation="")

    row = row_of(Verify(), item)

    assert {name: row[name] for name in (*OF_THE_FILE, *OF_THE_RUN)} == {
        **{"recording": "odd.mcap", "bytes": 11, "modified_ns": 12},
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        **{"rig": "7", "device": "beef", "run_id": "20261120T050000Z-0bad"},
        "experiment": "blackbox-validation-odd",
        "started": "2026-11-20T01:30:00-03:30",
        **{"Ts": 0.05, "samples": 497, "missing": 21},
        "calibration_sha256": hashlib.sha256(msgspec.json.encode(ODD)).hexdigest(),
        **{"recorded_by": "armrig 0.2.1", "damage": ""},
    }


@pytest.mark.parametrize("detrended", [False, True])
def test_each_option_of_a_task_reaches_its_estimate(folder: Path, detrended: bool) -> None:
    def treated(name: str) -> Any:
        data = armrig.load(folder / name).dataset("alpha")
        return armrig.detrend(data) if detrended else data

    items = {item.name: item for item in items_in(folder, rigs=["1"])}
    task = Identify(
        structure="arx", orders={"na": 3, "nb": 2}, nk=2, signal="alpha", detrend=detrended
    )
    fit = armrig.arx(treated("a-03.mcap"), na=3, nb=2, nk=2)
    compared = armrig.compare(treated("a-04.mcap"), fit)[0]

    row = row_of(task, items["a-03.mcap"])
    judged = row_of(Validate(model=model_text(fit), detrend=detrended), items["a-04.mcap"])

    assert (row["structure"], row["nk"], row["output"], row["integrator"]) == (
        *("arx", 2, "alpha", False),
    )
    assert row["parameters"] == fit.theta.tolist()
    assert (judged["output"], judged["rms_error"]) == ("alpha", compared.rms_error)
    assert judged["velocity_fit_percent"] is None


def test_finished_rows_are_not_computed_again(folder: Path, tmp_path: Path) -> None:
    few = few_of(folder, tmp_path, *(f"a-{n:02}.mcap" for n in range(4)))
    table = tmp_path / "models.parquet"
    done(few, ARX, table)
    first = table.read_bytes()
    assert computed(few, ARX, table) == []
    assert table.read_bytes() == first
    shutil.copy(folder / "a-30.mcap", few / "a-01.mcap")
    shutil.copy(folder / "a-31.mcap", few / "b.mcap")
    assert sorted(computed(few, ARX, table)) == ["a-01.mcap", "b.mcap"]


def test_a_report_is_written_again_after_a_new_validation() -> None:
    item = Item(name="a.mcap", path="/f/a.mcap", bytes=1, modified_ns=2, validation="")
    columns = columns_of(report(folder="reports"))
    known = {"recording": "a.mcap", "bytes": 1, "modified_ns": 2, "problem": ""}
    row = dict.fromkeys(columns) | known | {"validated_by": ""}
    assert still_right([row], [item], columns) == {"a.mcap": row}
    validated = item._replace(validation="/f/b.mcap")
    assert still_right([row], [validated], columns) == {}
    by_it = row | {"validated_by": "b.mcap"}  # as `report` writes it: a folder may be moved
    assert still_right([by_it], [validated], columns) == {"a.mcap": by_it}


def test_the_newest_of_several_validations_is_used(tmp_path: Path) -> None:
    of = {"validation_of": "0000000a"}
    runs = (
        ("blackbox", "13", "0000000a", {}),
        ("blackbox-validation", "14", "0000000b", of),
        ("blackbox-validation", "15", "0000000c", of),
        ("blackbox-validation", "16", "0000000d", {"validation_of": "0000000e"}),
    )
    for experiment, hour, run_id, details in runs:
        about = made_recordings.manifest(experiment=experiment, run_id=run_id, details=details)
        data = made_recordings.recorded(
            [made_recordings.sample(k) for k in range(3)], manifest=about
        )
        (tmp_path / f"1-{experiment}-20261120T{hour}0000-{run_id}.mcap").write_bytes(data)

    validations = {Path(item.validation).name for item in items_in(tmp_path)}

    assert validations == {"", "1-blackbox-validation-20261120T150000-0000000c.mcap"}


def test_the_age_of_a_run_in_parts_is_that_of_its_newest_part(tmp_path: Path) -> None:
    for number, seconds in ((1, 20), (2, 30), (3, 10)):
        part = tmp_path / f"a.part-{number:04}.mcap"
        part.write_bytes(bytes(number))
        os.utime(part, (seconds, seconds))

    [item] = items_in(tmp_path)

    assert (item.name, item.bytes, item.modified_ns) == ("a.mcap", 6, 30 * 10**9)


def test_the_progress_counts_only_the_items_of_this_start(folder: Path, tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    table = tmp_path / "v.parquet"
    told: list[tuple[int, int]] = []
    for name in ("a-00.mcap", "a-01.mcap"):
        shutil.copy2(folder / name, few)
        done(few, Verify(), table, count=lambda n, total, name: told.append((n, total)))
    assert told == [(1, 1), (1, 1)]


def test_results_of_other_options_are_refused(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "models.parquet"
    done(folder, ARX, table, kinds=["step"])
    with pytest.raises(OperationError, match="other options"):
        done(folder, Identify(structure="arx", orders={"na": 3, "nb": 4}), table)
    (tmp_path / f"checks.parquet{SUFFIX}").write_bytes(msgspec.json.encode({"task": "x"}) + b"\n")
    with pytest.raises(OperationError, match="--force"):
        done(folder, Verify(), tmp_path / "checks.parquet")
    done(folder, Verify(), tmp_path / "checks.parquet", anew=True, kinds=["step"])


def test_results_of_another_folder_or_choice_are_not_replaced(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "models.parquet"
    done(folder, ARX, table, rigs=["2"])
    before = table.read_bytes()
    with pytest.raises(OperationError, match="another folder, task or selection"):
        done(folder, ARX, table, kinds=["step"])
    other = tmp_path / "other"
    other.mkdir()
    shutil.copy2(folder / OTHER_RIG, other)
    with pytest.raises(OperationError, match="another folder, task or selection"):
        done(other, ARX, table, rigs=["2"])
    assert table.read_bytes() == before


def test_force_does_not_replace_the_rows_of_another_start(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "models.parquet"
    with Progress(table, {"digest": "held"}) as progress:
        progress.add({"recording": "a"})
        with pytest.raises(OperationError, match="batch uses it"):
            done(folder, ARX, table, anew=True)
    with Progress(table, {"digest": "held"}) as progress:
        assert progress.rows == [{"recording": "a"}]


def test_a_model_of_another_output_is_not_validated(folder: Path, tmp_path: Path) -> None:
    data = armrig.load(folder / "a-01.mcap").dataset()
    fit = armrig.arx(data.replaced(step=None, output="temp"), na=4, nb=4)
    task = Validate(model=model_text(fit))
    rows = done(folder, task, tmp_path / "v.parquet", rigs=["2"])
    assert "the model's output is temp" in rows[0]["problem"]


def test_a_torn_line_is_computed_again(tmp_path: Path) -> None:
    table, header = tmp_path / "t.parquet", {"task": "x"}
    with Progress(table, header) as progress:
        progress.add({"recording": "a"})
    with progress.path.open("ab") as file:
        file.write(b'{"recording": "b", "by')
    with Progress(table, header) as progress:
        assert progress.rows == [{"recording": "a"}]
        progress.add({"recording": "c"})
    with Progress(table, header) as progress:
        assert progress.rows == [{"recording": "a"}, {"recording": "c"}]


@pytest.mark.parametrize("row", [{}, [1], {"recording": ["a"]}, {"problem": "", "passed": "no"}])
def test_a_changed_row_is_computed_again(row: Any, folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "v.parquet"
    with Progress(table, header_of(Verify(), folder, ["2"], [])) as progress:
        progress.add(row)
    assert [r["recording"] for r in done(folder, Verify(), table, rigs=["2"])] == [OTHER_RIG]


def test_a_row_with_another_kind_of_value_is_refused(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "v.parquet"
    row = row_of(Verify(), items_in(folder, rigs=["2"])[0]) | {"passed": {"no": 1}}
    with Progress(table, header_of(Verify(), folder, ["2"], [])) as progress:
        progress.add(row)
    with pytest.raises(OperationError, match="somebody changed a row of this file; --force"):
        done(folder, Verify(), table, rigs=["2"])
    assert done(folder, Verify(), table, rigs=["2"], anew=True)[0]["passed"] is not None


@pytest.mark.parametrize("what", ["directory", "never ends"])
def test_a_folder_or_device_in_place_of_results_is_refused(
    what: str, folder: Path, tmp_path: Path
) -> None:
    """A link to /dev/zero would be read until the memory is full."""
    table = tmp_path / "v.parquet"
    there = tmp_path / f"v.parquet{SUFFIX}"
    if what == "directory":
        there.mkdir()
    else:
        there.symlink_to("/dev/null")  # as good as /dev/zero, were it read
    with pytest.raises(OperationError, match="is not a file; remove it"):
        done(folder, Verify(), table)


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """Let no file of this process become larger, as where the disk is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_loses_no_result(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "models.parquet"
    said = f"{table.name}{SUFFIX}: File too large; results so far are kept"
    with no_file_above(20_000), pytest.raises(OperationError, match=said):
        done(folder, ARX, table)
    assert 0 < len(computed(folder, ARX, table)) < MANY + 4


def test_a_disk_too_full_for_the_table_loses_no_result(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "v.parquet"
    said = f"{table.name}: File too large; all results are kept"
    with no_file_above(8000), pytest.raises(OperationError, match=said):
        done(folder, Verify(), table, rigs=["2"])
    assert [file.name for file in tmp_path.iterdir()] == [f"v.parquet{SUFFIX}"]
    assert computed(folder, Verify(), table, rigs=["2"]) == []


def test_an_item_that_kills_its_workers_is_abandoned_and_the_others_finish() -> None:
    """Each other item has its own result, once."""
    items = ["a", "b", "deadly", "c", "d"]
    came = list(results(deadly, items, partial(workers.processes, 2), at_once=4))
    assert sorted(item for item, _ in came) == sorted(items)
    for item, result in came:
        if item == "deadly":
            assert "died 2 times" in str(result)
        else:
            assert result == item.upper()


class Mortal(Executor):
    """Works in its own thread; the item "deadly" breaks it, and its pending work is lost."""

    def __init__(self, runs: list[str]) -> None:
        self._runs = runs

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self._runs.append(args[0])
        if "deadly" in self._runs:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(function(args[0]))
        return future


@pytest.mark.parametrize(("at_once", "tries"), [(1, 2), (3, 3)])
def test_an_item_kills_a_bounded_number_of_workers(at_once: int, tries: int) -> None:
    runs: list[list[str]] = []

    def opened() -> Executor:
        runs.append([])
        return Mortal(runs[-1])

    came = dict(results(str.upper, ["a", "deadly", "b"], opened, at_once=at_once))

    assert sum("deadly" in run for run in runs) == tries
    assert "died 2 times" in str(came.pop("deadly"))
    assert came == {"a": "A", "b": "B"}


def test_an_interrupted_batch_does_not_wait_for_the_workers() -> None:
    at_work: list[Future[None]] = []

    def interrupted() -> None:
        with workers.processes(1) as executor:
            assert executor.submit(abs, -1).result() == 1
            at_work.append(executor.submit(time.sleep, 600.0))
            while not at_work[0].running():
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert isinstance(at_work[0].exception(), BrokenExecutor)


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(one) for one in text.split()]


def working(pid: int) -> list[int]:
    """Return those of its processes that do the work."""
    return [c for c in children(pid) if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]


def is_alive(pid: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are seen in /proc")
def test_a_killed_batch_continues_to_the_same_table(
    lab: tuple[Path, bytes], tmp_path: Path
) -> None:
    folder, whole = lab
    table = tmp_path / "models.parquet"
    with started(folder, table, "--workers", "2") as process:
        wait_for_rows(table, 3, process)
        its = working(process.pid)
        process.kill()
        process.wait()
    assert len(its) == 2
    until = time.monotonic() + 30
    while any(map(is_alive, its)) and time.monotonic() < until:
        time.sleep(0.01)
    assert not any(map(is_alive, its))
    left = kept(table)
    with started(folder, table, "--workers", "2") as process:
        said = process.communicate(timeout=300)[1]
    assert process.returncode == 0, said
    assert table.read_bytes() == whole
    assert len({json.loads(line)["recording"] for line in left}) == len(left) >= 3
    assert not table.with_name(table.name + SUFFIX).exists()


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are seen in /proc")
def test_a_killed_worker_loses_no_row(lab: tuple[Path, bytes], tmp_path: Path) -> None:
    folder, whole = lab
    table = tmp_path / "models.parquet"
    with started(folder, table, "--workers", "2") as process:
        wait_for_rows(table, 2, process)
        os.kill(working(process.pid)[0], signal.SIGKILL)
        said = process.communicate(timeout=300)[1]
    assert process.returncode == 0, said
    assert table.read_bytes() == whole


def test_a_name_that_is_not_utf_8_is_processed(folder: Path, tmp_path: Path) -> None:
    few = Path(os.fsdecode(os.fsencode(tmp_path) + b"/f\xfcnf"))
    few.mkdir()
    shutil.copy2(folder / "a-00.mcap", os.fsencode(few) + b"/\xe9t\xe9.mcap")
    (few / os.fsdecode(b"\xff.mcap")).write_bytes(b"no recording at all")
    table = few / os.fsdecode(b"\xe0.parquet")
    done(few, ARX, table)
    again = computed(few, ARX, table)
    rows = rows_of(table)
    assert [row["recording"] for row in rows] == [r"\udce9t\udce9.mcap", r"\udcff.mcap"]
    assert rows[0]["fit_percent"] > 0
    assert r"f\udcfcnf/\udcff.mcap" in rows[1]["problem"]
    assert again == [r"\udcff.mcap"]


def test_a_file_with_any_time_stamp_does_not_stop_the_batch(folder: Path, tmp_path: Path) -> None:
    """A clock was wrong by centuries: more nanoseconds than the table can hold."""
    few = few_of(folder, tmp_path, "a-00.mcap")
    os.utime(few / "a-00.mcap", (0, 13_569_465_600))  # 2400
    assert done(few, Verify(), tmp_path / "v.parquet")[0]["problem"] == ""


@pytest.fixture
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command do its work in a thread of this process, which starts faster than another."""
    monkeypatch.setattr(workers, "processes", ThreadPoolExecutor)


@pytest.mark.usefixtures("one_thread")
def test_damage_is_reported_with_the_result(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    few = few_of(folder, tmp_path, CUT)
    whole = (folder / "a-00.mcap").read_bytes()
    (few / "none.mcap").write_bytes(whole[: len(whole) // 3])
    given = ["batch", "identify", str(few), "-o", str(tmp_path / "m.parquet"), "--workers", "1"]

    assert main(given) == 1
    said = capsys.readouterr().out
    assert f"\n  {CUT}: the result covers the undamaged part: the file is cut off: it ends " in said
    assert "\n  none.mcap: the file is cut off: it ends " in said
    assert "; saved: 0 samples, " in said
    assert "none.mcap: none of its 0 samples shows theta_1; record again" in said


@pytest.mark.parametrize(
    ("err", "problem"),
    [
        (FileError("a first\n  line"), "a first line"),
        (FileError(""), "FileError"),
        (OSError(2, "No such\nfile", "/a/b"), "/a/b: No such file"),
        (OSError("odd"), "odd"),
        (KeyError("x\ny"), "KeyError: 'x\\ny'"),
    ],
)
def test_each_problem_is_reported_in_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, err: Exception, problem: str
) -> None:
    def refused(_: object) -> None:
        raise err

    monkeypatch.setattr("armrig.report.batch.tasks.load", refused)

    assert row_of(Verify(), items_in(folder)[0])["problem"] == problem
