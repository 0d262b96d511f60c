"""Rows that the page keeps, and their drawing; in node."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import armrig.dashboard
import pytest

from tests.tools import needs

NODE = shutil.which("node")
pytestmark = needs("node")
ROWS = Path(armrig.dashboard.__file__).parent / "page" / "rows.js"
THETA_1 = 1  # its place among the signals


def _run(script: str) -> Any:
    """Return the JSON output of a script, which has the module as `rows`."""
    source = base64.b64encode(ROWS.read_bytes()).decode()
    program = f'const rows = await import("data:text/javascript;base64,{source}");\n{script}'
    command = [str(NODE), "--input-type=module", "-e", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return json.loads(done.stdout)


def _drawn(*lines: list[float | None], pixels: int, wraps: bool = True) -> Any:
    """Return, for each line of samples 10 ms apart, x, least and largest on so many pixels."""
    asked = [
        {
            "sent": [[k / 100, 0, 0, y, y, 0, 0, 0, 0] for k, y in enumerate(line)],
            "view": {"from": 0, "to": len(line) / 100, "zero": 0, "pixels": pixels, "wraps": wraps},
        }
        for line in lines
    ]
    return _run(
        f"const drawn = {json.dumps(asked)}.map(({{ sent, view }}) => {{"
        "  const kept = new rows.Rows(); kept.add(sent);"
        f" return kept.drawn({THETA_1}, view); }});"
        "console.log(JSON.stringify(drawn));"
    )


@pytest.mark.parametrize("pixels", [50, 400])
def test_a_wrap_breaks_the_line(pixels: int) -> None:
    """Either way round, with a dead band of 0 to 3 samples."""
    lines = []
    for turn, dead_band in itertools.product((1, -1), (0, 1, 3)):
        line: list[float | None] = [float((350 + turn * 3 * k) % 360) for k in range(-60, 60)]
        at = next(k for k in range(1, 120) if abs(line[k] - line[k - 1]) > 180)  # type: ignore[operator]
        line[at : at + dead_band] = [None] * dead_band
        lines.append(line)

    for x, low, high in _drawn(*lines, pixels=pixels):
        assert x == sorted(x)
        known = [(a, b) for a, b in zip(low, high, strict=True) if a is not None]
        assert all(b - a < 180 for a, b in known)
        neighbours = [(a, b) for a, b in itertools.pairwise(low) if None not in (a, b)]
        assert all(abs(b - a) < 180 for a, b in neighbours)
        assert None in low


def test_a_jump_does_not_break_the_line_of_a_signal_without_wraps() -> None:
    """A rate that jumps by more than 180 °/s is one line."""
    [[_, low, _]] = _drawn([0.0] * 50 + [300.0] * 50, pixels=400, wraps=False)

    assert None not in low


def _times(times: list[float]) -> str:
    """Return the beginning of a script, with rows at these times in s as `kept`."""
    sent = [[t, 0, 0, 9, 9, 0, 0, 0, 0] for t in times]
    return f"const kept = new rows.Rows(); kept.add({json.dumps(sent)});"


@pytest.mark.parametrize("Ts", [0.01, 0.3, 0.5, 1.0])
def test_samples_are_joined_by_a_line_at_any_sampling_time(Ts: float) -> None:
    times = [k * Ts for k in range(20)] + [k * Ts + 20 * Ts + 1.0 for k in range(20)]
    spans = (5, 30, 300)
    views = [{"from": 0, "to": s, "pixels": 700 * s, "zero": 0, "wraps": True} for s in spans]
    drawn = _run(
        f"{_times(times)} const drawn = {json.dumps(views)}.map((v) => kept.drawn({THETA_1}, v));"
        "console.log(JSON.stringify(drawn));"
    )

    for span, (_, low, _) in zip(spans, drawn, strict=True):
        assert low[:40].count(None) == (1 if times[20] <= span else 0)


def test_the_cursor_shows_no_value_in_a_gap() -> None:
    times = [1.0 + k / 100 for k in range(100)] + [5.0 + k / 100 for k in range(100)]
    asked = [0.5, 1.0, 1.555, 3.0, 5.0, 7.0]
    held = _run(
        _times(times) + f"console.log(JSON.stringify({asked}.map((t) => kept.holding(t))));"
    )

    assert held == [None, 0, 55, None, 100, 199]


def test_a_repeated_row_is_discarded_and_an_older_clock_clears_the_rows() -> None:
    lengths = _run(
        "const kept = new rows.Rows(); const row = (t) => [t, 0, 0, 0, 0, 0, 0, 0, 0];"
        "kept.add([1000, 1001, 1002].map(row)); const a = kept.length;"
        "kept.add([1001, 1002, 1003].map(row)); const b = kept.length;"
        "kept.add([1, 2].map(row)); console.log(JSON.stringify([a, b, kept.length]));"
    )

    assert lengths == [3, 4, 2]


def test_rows_of_the_last_five_minutes_are_kept() -> None:
    """The memory of the page is bounded at any rate of rows."""
    spans = _run(
        "const kept = new rows.Rows();"
        "for (let t = 0; t < 1000; t += 0.5) kept.add([[t, 0, 0, 0, 0, 0, 0, 0, 0]]);"
        "const slow = [kept.length, kept.newest - kept.at(0, 0)]; kept.begin();"
        "for (let i = 0; i < 100000; i += 1) kept.add([[i / 1000, 0, 0, 0, 0, 0, 0, 0, 0]]);"
        "console.log(JSON.stringify([...slow, kept.length]));"
    )

    assert spans[0] <= 2 * 330
    assert spans[1] >= 300 - 1
    assert spans[2] <= 40_000


def test_rows_exactly_at_an_edge_belong_to_the_view() -> None:
    found = _run(
        "const row = (t) => [t, 0, 0, t, t, 0, 0, 0, 0]; const made = (...times) => {"
        "const kept = new rows.Rows(); kept.add(times.map(row)); return kept; };"
        "const five = made(0, 1, 2, 3, 4);"
        "const view = { from: 1, to: 3, pixels: 1000, zero: 4, wraps: false };"
        "const again = made(1000, 1000); const older = made(1000, 700);"
        "const old = made(1000, 701);"
        "const long = made(0, 29, 30, 31, 200, 330.5, 331);"
        "console.log(JSON.stringify({ find: [-1, 0, 2, 2.5, 4, 5].map((t) => five.find(t)),"
        f" drawn: five.drawn({THETA_1}, view), sent: [again.length, older.length, older.newest,"
        " old.newest], kept: [long.at(0, 0), long.length] }));"
    )

    assert found["find"] == [0, 0, 2, 3, 4, 5]
    assert found["drawn"][:2] == [
        [-4, -3, -2, -1],
        [0, 1, 2, 3],
    ]  # and one row before, for its line
    assert found["sent"] == [1, 1, 700, 1000]  # five minutes before the newest: another clock
    assert found["kept"] == [31, 4]


def test_each_signal_is_drawn_from_its_columns() -> None:
    sent = [[k / 64, *(10 * s + side + k for s in range(4) for side in (1, 2))] for k in range(7)]
    view = {"from": 0, "to": 5, "pixels": 64, "zero": 0, "wraps": False}
    drawn = _run(
        f"const kept = new rows.Rows(); kept.add({json.dumps(sent)});"
        f"console.log(JSON.stringify([0, 1, 2, 3].map((s) => kept.drawn(s, {json.dumps(view)}))));"
    )

    for s, (x, low, high) in enumerate(drawn):
        assert x == [k / 64 for k in (0, 4, 5, 6)]  # of five rows of a pixel the first and the last
        assert low == [10 * s + 1 + k for k in (0, 4, 5, 6)]
        assert high == [10 * s + 2 + k for k in (0, 4, 5, 6)]


def test_a_pixel_has_its_extremes_at_their_own_times() -> None:
    [[x, low, _]] = _drawn([5.0, 6.0, 9.0, 8.0, None, 2.0, 3.0, 4.0] + [4.0] * 392, pixels=50)

    assert x[:4] == [0.0, 0.02, 0.05, 0.07]
    assert low[:4] == [5.0, 9.0, 2.0, 4.0]


def test_every_sample_next_to_a_wrap_is_drawn() -> None:
    """Each sample is drawn if a pixel has at most four."""
    lines = [[(350 + step * k) % 360 for k in range(100)] for step in (3.0, 110.0, -110.0)]

    for line, (x, low, _) in zip(lines, _drawn(*lines, pixels=50), strict=True):
        assert [y for y in low if y is not None] == line
        assert x == sorted(x)


def test_live_rows_received_before_the_history_are_drawn_after_it() -> None:
    rows = [[t / 10, 0, 0, t, t, 0, 0, 0, 0] for t in range(6)]
    times = _run(
        f"const sent = {json.dumps(rows)}; const kept = new rows.Rows();"
        "const times = () => Array.from({length: kept.length}, (_, i) => kept.at(i, 0));"
        "kept.add(sent.slice(4)); kept.begin();"
        "kept.addLive(sent.slice(3, 4)); kept.addLive(sent.slice(4, 5));"
        "kept.add(sent.slice(0, 4));"
        "const before = times(); kept.endPast(); kept.addLive(sent.slice(5));"
        "console.log(JSON.stringify([before, times()]));"
    )

    assert times == [[0.0, 0.1, 0.2, 0.3], [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]]
