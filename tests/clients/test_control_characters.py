"""Names with control characters and escape sequences are harmless in figures, page and report."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import armrig
import msgspec
import numpy as np
import pytest
from armrig.dashboard.app import error, value
from armrig.dashboard.page_json import page_json
from armrig.dashboard.stream import event
from armrig.dashboard.study_of_one import facts
from armrig.plots.captions import name_by_run, sign
from armrig.plots.layout import axes, drawable, save
from armrig.recordings.files.catalogue import catalogue
from armrig.report.typesetting import latest_start as date_of
from armrig_core.process.printable import printable_texts
from matplotlib.figure import Figure

from tests.clients.made_recordings import event as log
from tests.clients.made_recordings import manifest, note, recorded, sample, written

HOSTILE = "\x1b]0;mine\x07\x1b[2Ja\x9b[red]\u202e"
SHOWN = "\\x1b]0;mine\\x07\\x1b[2Ja\\x9b[red]\\u202e"


def _data(name: str) -> armrig.Dataset:
    rng = np.random.default_rng(1)
    u = rng.choice([0.5, 4.5], 400)
    y = np.convolve(u, [0.0, 0.5, 0.2])[:400] + 0.01 * rng.standard_normal(400)
    return armrig.Dataset(u=u, y=y, Ts=0.1, output=name, unit="V", source=f"{name}:{name}")


@pytest.mark.parametrize(
    "drawn",
    [
        lambda data: data,
        lambda data: data.plot("spectrum"),
        lambda data: armrig.compare(data, armrig.arx(data, na=1, nb=2)),
        lambda data: armrig.residuals(armrig.arx(data, na=1, nb=2), data),
        armrig.delay,
        armrig.linearity,
        armrig.spa,
    ],
)
def test_a_figure_has_no_control_character(drawn: Callable[[Any], Any], tmp_path: Path) -> None:
    """An SVG must not contain them: no browser, and no report, showed such a figure."""
    made = drawn(_data(HOSTILE))
    figure = made if isinstance(made, Figure) else made.plot()

    save(figure, tmp_path / "figure.svg")

    text = (tmp_path / "figure.svg").read_text()
    ElementTree.fromstring(text)
    assert all(c.isprintable() or c in "\u00a0\n" for c in text)


def test_the_id_of_a_run_in_a_figure_is_printable(tmp_path: Path) -> None:
    with name_by_run({"5ca1e": HOSTILE}):
        ax = sign(axes(None), "5ca1e")

    assert ax.get_title(loc="right") == f"recording @{SHOWN}"
    assert drawable(f"a\n{HOSTILE}\u00a0V") == f"a\n{SHOWN}\u00a0V"


def test_texts_of_the_page_are_printable(tmp_path: Path) -> None:
    messages = [*(sample(k) for k in range(9)), log(3, HOSTILE), note(4, HOSTILE, HOSTILE)]
    about = manifest(run_id=HOSTILE, experiment=f"blackbox-{HOSTILE}", owner=HOSTILE)
    path = written(tmp_path, recorded([*messages, sample(9)], manifest=about))

    found = facts(path)
    answers = value(found).body, error(400, HOSTILE).body, event("status", {HOSTILE: [HOSTILE]})

    for answer in map(bytes, answers):
        assert SHOWN in answer.decode().replace("\\\\", "\\")
        assert b"\\u00" not in answer
        assert all(c.isprintable() or c in "\u00a0\n" for c in answer.decode())
    assert json.loads(bytes(answers[0]))["curves"] == msgspec.to_builtins(found["curves"])


def test_json_for_the_page_keeps_numbers_lines_and_spaces() -> None:
    rows = {"rows": [[1, 0.1, None], [2, 1e-9, float("nan")]], "text": "5\u00a0V\n\tλ", "is": True}

    assert page_json(rows) == msgspec.json.encode(rows)
    assert page_json(rows | {"a": "\0"}) == msgspec.json.encode(rows | {"a": "\\x00"})
    assert printable_texts([1, {"\x07": "\x7f"}]) == [1, {"\\x07": "\\x7f"}]


@pytest.mark.parametrize(
    "started", ["9999-12-31T23:59:59-12:00", "0001-01-01T00:00:00+14:00", "yesterday", ""]
)
def test_a_time_that_is_no_time_in_utc_is_no_time(started: str, tmp_path: Path) -> None:
    """The date of a report overflowed: 9999-12-31 west of Greenwich is in the year 10000."""
    data = recorded([sample(k) for k in range(9)], manifest=manifest(started=started))
    path = written(tmp_path, data, "run.mcap")

    assert date_of([armrig.load(path)]).year == 1970
    assert catalogue(tmp_path).to_pandas()["started"].isna().all()
