"""The page's texts of timing, age and runs, and the buttons it offers; in node, on stubs."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import armrig.dashboard
import pytest
from armrig.dashboard.feed import LATE_US

from tests.clients.said import compare

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="no node")
PAGE = Path(armrig.dashboard.__file__).parent / "page"
_PAGE = """
class Element {
  constructor() {
    Object.assign(this, { textContent: "", hidden: false, className: "", style: {}, dataset: {} });
    Object.assign(this, { children: [], attributes: {} });
    this.classList = { toggle: () => {} };
  }
  setAttribute(name, value) { this.attributes[name] = value; }
  append(...made) { this.children.push(...made); }
  replaceChildren(...made) { this.children = made; }
  addEventListener() {}
  scrollIntoView() {}
}
const there = {};
globalThis.location = { hash: "#token=x" };
globalThis.document = {
  getElementById: (id) => (there[id] ??= new Element()),
  createElement: () => new Element(),
  createElementNS: () => new Element(),
  body: new Element(),
};
globalThis.performance = { now: () => globalThis.at ?? 0 };
const status = await import("./status.js");
const control = await import("./control.js");
const text = (id) => document.getElementById(id).textContent;
const hidden = (id) => document.getElementById(id).hidden;
const disabled = (id) => document.getElementById(id).disabled;
const told = {};
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the page's scripts as modules that node takes."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "package.json").write_text('{"type": "module"}')
    for script in PAGE.glob("*.js"):
        shutil.copy(script, folder)
    return folder


def _run(page: Path, script: str) -> Any:
    """Return the value that a script leaves in `told`."""
    (page / "test.js").write_text(f"{_PAGE}\n{script}\nconsole.log(JSON.stringify(told));")
    command = [str(NODE), str(page / "test.js")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_timing_is_shown_under_its_names(page: Path) -> None:
    timing = {
        "late": [5, *[0] * (len(LATE_US) - 1), 7],
        "missing": 3,
        "unheard": 4,
        "last_gap": "link silent",
        "report": {
            "late_p50_us": 2.25,
            "late_p99_us": 40,
            "late_max_us": 1500,
            "device_p99_us": 7,
            "link_p99_us": 999,
        },
        "model": ["gain 1"],
    }
    told = _run(
        page,
        f"status.begin({json.dumps(LATE_US)}); status.showTiming({json.dumps(timing)});"
        "told.timing = text('timing-text'); told.missing = text('missing');"
        "told.bars = document.getElementById('histogram').children.map("
        "(bar) => [bar.title, bar.children[0], bar.children[2], bar.children[1].style.height]);"
        "told.pressed = document.getElementById('model-wanted').attributes['aria-pressed'];",
    )

    assert told["timing"] == (
        "host's lateness: p50 2.3 µs, p99 40 µs, max 1.5 ms; "
        "error of the device's period: p99 7.0 µs; round trip: p99 999 µs"
    )
    assert told["missing"] == (
        "missing: 3 samples since this dashboard was started; reason of the last gap: link silent; "
        "4 samples did not reach the dashboard's server, but are in recordings"
    )
    assert len(told["bars"]) == len(LATE_US) + 1
    assert told["bars"][0][:3] == ["5 samples, at most 50 µs late", "5", "0.05"]
    assert told["bars"][1][1:] == ["", "0.1", "0%"]
    assert told["bars"][-1] == ["7 samples, later", "7", "more", "80%"]
    assert told["pressed"] == "true"


def test_data_that_waited_in_a_slow_network_are_older(page: Path) -> None:
    told = _run(
        page,
        "const ages = [];"
        "const came = [[1000, 500], [2000, 501], [6000, 502], [7000, 506], [8000, 3]];"
        "for (const [at, at_s] of came) {"
        " globalThis.at = at; if (at_s === 3) status.begin([]);"
        " status.showLive({ at_s, age_s: 0.25, is_stale: false }); ages.push(text('age')); }"
        "told.ages = ages;",
    )

    assert told["ages"] == ["0.25 s old", "0.25 s old", "3.25 s old", "0.25 s old", "0.25 s old"]


def test_the_age_goes_on_while_nothing_comes(page: Path) -> None:
    """The age is that of the last message plus the time since then."""
    told = _run(
        page,
        "globalThis.at = 1000; status.showLost('gone'); told.none = text('stale-what');"
        "status.showStatus({ rows: [], phase: 'safe', trouble: '' });"
        "status.showLive({ at_s: 7, age_s: 0.05, is_stale: false });"
        "told.fresh = [text('age'), hidden('stale'), text('phase')];"
        "globalThis.at = 3500; status.showLost('the server is silent');"
        "told.lost = [text('age'), hidden('stale'), text('phase'), text('stale-what'),"
        " text('stale-why')];",
    )

    assert told == {
        "none": "No data from the rig yet.",
        "fresh": ["0.05 s old", True, "safe"],
        "lost": [
            "2.55 s old",
            False,
            "no data",
            "No data from the rig for 2.55 s; the last phase was safe.",
            "the server is silent",
        ],
    }


def test_without_fresh_data_a_value_is_the_last_one_and_the_motor_is_not_known(page: Path) -> None:
    told = _run(
        page,
        "status.showStatus({ rows: [['motor', 'at 0 V']], phase: 'safe' });"
        "const seen = () => [status.dated('4.50 V'), document.getElementById('status')"
        ".children[1].textContent];"
        "told.none = seen(); const live = { at_s: 7, age_s: 0.5, is_stale: false };"
        "status.showLive(live); told.fresh = seen(); globalThis.at = 2000;"
        "status.showLive({ ...live, at_s: 9, is_stale: true }); told.stale = seen();"
        "status.showLive(live); status.showLost('silent'); globalThis.at = 3000;"
        "told.lost = seen();",
    )

    assert told == {
        "none": ["not known", "not known"],
        "fresh": ["4.50 V", "at 0 V"],
        "stale": ["last: 4.50 V, 0.5 s ago", "not known"],
        "lost": ["last: 4.50 V, 3.5 s ago", "not known"],
    }


def test_one_cause_has_one_message(page: Path) -> None:
    told = _run(
        page,
        "const said = () => [text('phase'), hidden('fault'), hidden('stale'), text('stale-why')];"
        "const fault = { rows: [], phase: 'fault', fault: 'stale', reason: 'r', line: 'port' };"
        "const live = { at_s: 7, age_s: 0.5, is_stale: true };"
        "status.showLive(live); status.showStatus(fault); told.fault = said();"
        "status.showStatus({ ...fault, trouble: 'no daemon' }); told.daemon = said();"
        "status.showStatus(fault); status.showLost('silent'); told.server = said();"
        "status.showLive(live); status.showStatus({ ...fault, reason: '' }); told.line = said();",
    )

    assert told == {
        "fault": ["fault", False, True, told["fault"][3]],
        "daemon": ["no data", True, False, "no daemon"],
        "server": ["no data", True, False, "silent"],
        "line": ["no data", True, False, "port"],
    }


def test_each_row_of_the_status_is_shown_in_one_of_two_lists(page: Path) -> None:
    rows = [["sampled", "at 100 Hz"], ["owner", "Ada"], ["firmware", "0"]]
    told = _run(
        page,
        f"status.showStatus({{ rows: {json.dumps(rows)}, phase: 'safe' }});"
        "const words = (id) => document.getElementById(id).children.map((x) => x.textContent);"
        "told.lists = [words('status'), words('status-all')];",
    )

    assert told["lists"] == [["owner", "Ada"], ["sampled", "at 100 Hz", "firmware", "0"]]


def test_a_button_is_offered_where_the_rig_can_take_it(page: Path) -> None:
    told = _run(
        page,
        "const offered = () => ['run', 'arm', 'release'].filter((id) => !disabled(id)).join(' ');"
        "const run = (is_going) => control.showRun({ is_going, experiment: '' });"
        "status.showLive({ at_s: 7, age_s: 0, is_stale: false }); run(false);"
        "control.offer({ kind: 'step' });"
        "for (const phase of ['init', 'safe', 'armed', 'active', 'fault']) {"
        "  control.showControl({ phase, trouble: '' }); told[phase] = offered(); }"
        "control.showControl({ phase: 'safe', trouble: '' }); run(true); told.going = offered();"
        "run(false); control.offer(null); told.unseen = offered();"
        "run(false); status.showLive({ at_s: 7, age_s: 9, is_stale: true }); control.allow();"
        "told.stale = offered();",
    )

    assert told == {
        "init": "",
        "safe": "run arm",
        "armed": "run release",
        "active": "",
        "fault": "",
        "going": "",
        "unseen": "arm",
        "stale": "",
    }


def test_a_run_is_shown_with_its_progress_and_its_end(page: Path) -> None:
    going = {"is_going": True, "experiment": "step", "done": 30, "total": 120, "told": "t"}
    file = {"file": "a.mcap", "finished": True, "outcome": "stopped by Ada"}
    ended = {"is_going": False, "experiment": "step", "done": 120, "total": 120, "verdict": "v"}
    told = _run(
        page,
        "const rig = { phase: 'active', Ts: 0.1 }; control.showControl(rig);"
        "const say = () => [text('running-text'), text('running-told'),"
        " document.getElementById('progress').value, hidden('progress'), hidden('look')];"
        f"control.showRun({json.dumps(going)}); told.going = say();"
        f"control.showRun({json.dumps({**ended, 'recording': 'a.mcap'})}); told.ended = say();"
        f"control.showRun({json.dumps({**ended, 'error': 'stopped', 'recording': ''})});"
        "told.refused = say();"
        f"control.showControl({{ ...rig, last_run: {json.dumps(file)} }});"
        f"control.showRun({json.dumps({**ended, 'error': 'x', 'recording': 'a.mcap'})});"
        "told.stopped = say();"
        "control.showControl({ ...rig, reason: 'no answer' }); told.fault = say();",
    )

    assert told == {
        "going": ["step: 9.0 s left", "t", 0.25, False, True],
        "ended": ["step is recorded: a.mcap", "v", 1, True, False],
        "refused": ["step failed: stopped", "v", 1, True, True],
        "stopped": ["step ended early, after 12 s: stopped by Ada", "v", 1, True, False],
        "fault": ["step ended early, after 12 s: see the fault", "v", 1, True, False],
    }


def test_another_recording_is_shown_in_its_whole_length(page: Path) -> None:
    curves = {name: [[], [], []] for name in ("u", "theta_1", "rate", "alpha")}
    found = {"seconds": 10, "summary": "", "usable": True, "about": [], "findings": [], "gaps": []}
    found |= {"notes": []}
    told = _run(
        page,
        "const charts = [];"
        "globalThis.uPlot = class {"
        "  constructor(options) { this.options = options; charts.push(this); }"
        "  destroy() {} setData() {} };"
        f"const found = {json.dumps({**found, 'curves': curves})};"
        "globalThis.fetch = async (path) =>"
        "  ({ ok: true, json: async () => (path.endsWith('curves') ? found.curves : found) });"
        "const { look } = await import('./recording.js');"
        "const shown = () => [text('seen').slice(0, 12), charts.at(-1).wanted];"
        "await look('a.mcap'); told.first = shown();"
        "charts[0].options.hooks.setSelect[0]("
        "  { select: { left: 20, width: 30 }, posToVal: (x) => x / 10, setSelect: () => {} });"
        "await new Promise((done) => setTimeout(done, 0)); told.zoomed = shown();"
        "await look('b.mcap'); told.second = shown();",
    )

    assert told == {
        "first": ["drag across ", [0, 10]],
        "zoomed": ["2.00 to 5.00", [2, 5]],
        "second": ["drag across ", [0, 10]],
    }


def test_what_the_page_shows_is_what_it_showed(page: Path) -> None:
    file = Path(__file__).with_name("page_story.txt")
    stored = file.read_text(encoding="utf-8")
    script = "".join(f"{x}\n" for x in stored.splitlines() if x.startswith(("> ", "#")))
    shutil.copy(Path(__file__).with_name("page_stage.js"), page)
    command = [str(NODE), str(page / "page_stage.js")]

    done = subprocess.run(
        command, input=script, capture_output=True, text=True, timeout=60, check=False
    )

    assert done.returncode == 0, done.stderr
    compare(file, done.stdout)
