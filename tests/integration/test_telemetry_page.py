"""docs/telemetry.md: its programs run next to a daemon, in an environment without armrig."""

from __future__ import annotations

import csv
import itertools
import json
import re
import signal
import subprocess
import venv
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import armrig
import numpy as np
import pytest
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Sample, decode_sample
from mcap.reader import make_reader

from tests.integration.driving import samples
from tests.integration.processes import Bench, wait_for

PAGE = Path(__file__).parents[2] / "docs" / "telemetry.md"
_PROGRAM = re.compile(r"```python\n# (\w+\.py) .*?\n(.*?)```", re.DOTALL)
_NEEDED = ("eclipse-zenoh", "protobuf", "mcap", "lz4", "zstandard")
_WITHIN_S = 60


class Programs(NamedTuple):
    """The page's programs in a folder, and a Python with only the page's packages."""

    folder: Path
    python: Path

    def start(self, name: str, *arguments: str) -> subprocess.Popen[str]:
        """Start a program with its output piped."""
        return subprocess.Popen(
            [self.python, "-I", "-u", self.folder / name, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, name: str, *arguments: str) -> str:
        """Return the output of a program until its end."""
        program = self.start(name, *arguments)
        printed, said = program.communicate(timeout=_WITHIN_S)
        assert (program.returncode, said) == (0, "")
        return printed


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Programs:
    """Give the programs, and an environment made of links to the libraries installed here."""
    folder = tmp_path_factory.mktemp("page")
    for name, text in _PROGRAM.findall(PAGE.read_text(encoding="utf-8")):
        (folder / name).write_text(text, encoding="utf-8")
    venv.create(folder / "venv", symlinks=True)
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    for needed in _NEEDED:
        found = metadata.distribution(needed)
        for top in {file.parts[0] for file in found.files or () if file.parts[0] != ".."}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(found.locate_file(top))))
    return Programs(folder, folder / "venv" / "bin" / "python")


def _rows(printed: str) -> list[list[str]]:
    return [*csv.reader(printed.splitlines())]


def test_the_environment_of_the_page_s_programs_has_no_armrig(programs: Programs) -> None:
    """Otherwise the other tests of this page would prove nothing."""
    for module in ("armrig", "armrig_core", "numpy"):
        command = [programs.python, "-I", "-c", f"import {module}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert f"No module named '{module}'" in done.stderr


def test_the_subscriber_prints_each_sample(served: Bench, programs: Programs) -> None:
    rows = _rows(programs.run("subscribe.py", served.endpoint, "50"))

    k = np.array([int(row[0]) for row in rows])
    assert [len(row) for row in rows] == [6] * 50
    assert (np.diff(k) >= 1).all()
    assert {float(row[2]) for row in rows} == {0.0}


def test_the_recorder_of_the_page_records_every_published_message(
    served: Bench, programs: Programs
) -> None:
    file = programs.folder / "recorded.mcap"
    program = programs.start("record.py", served.endpoint, str(file))
    assert program.stdout is not None
    wanted = {f"recording rig/1/{stream}" for stream in ("sample", "state")}
    begun: set[str] = set()
    while len(begun) < 4 or not wanted <= begun:  # each is printed once, the slowest after a second
        line = program.stdout.readline()
        assert line, begun
        begun.add(line.strip())
    with served.rig() as rig:  # a device that was silent for a moment makes few samples in a second
        heard = list(itertools.islice(samples(rig), 20))
    program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=_WITHIN_S)

    assert (program.returncode, said) == (0, "")
    with file.open("rb") as stream:
        messages = [*make_reader(stream).iter_messages()]
    for schema, channel, _ in messages:
        name = protobuf.OF_STREAM[channel.topic.removeprefix("/rig/1/")]
        assert (schema.name, schema.encoding) == (name, "protobuf")
        assert schema.data == protobuf.descriptor_set(name)
    recorded = [decode_sample(m.data) for _, c, m in messages if c.topic == "/rig/1/sample"]
    assert len(recorded) >= len(heard) / 2
    assert all(isinstance(sample, Sample) for sample in recorded)
    assert len({c.topic for _, c, _ in messages}) >= 4


def test_the_reader_of_the_page_reads_the_same_values_as_armrig(
    served: Bench, programs: Programs
) -> None:
    with served.rig() as rig:
        rig.arm("a test")
        path = rig.run([1.0, 4.0] * 50)

    rows = _rows(programs.run("read.py", str(path)))

    samples = armrig.load(path).samples
    fields = ("k", "t_host_ns", "u_applied_v", "theta_1_rad", "alpha_rad", "flags")
    read = np.array(rows, dtype=np.float64).T
    for name, column in zip(fields, read, strict=True):
        np.testing.assert_array_equal(column, samples[name].astype(np.float64))


def test_the_page_s_program_reads_the_status_and_stops_the_rig(
    served: Bench, programs: Programs
) -> None:
    status = json.loads(programs.run("ask.py", served.endpoint, "status"))
    with served.rig() as rig:
        rig.arm("a test")
        stopped = json.loads(programs.run("ask.py", served.endpoint, "stop"))
        wait_for(lambda: rig.status().phase == "safe")
    refused = json.loads(programs.run("ask.py", served.endpoint, "fly"))

    assert (status["rig"], status["phase"], status["owner"]) == ("1", "safe", "")
    assert stopped == {"done": True}
    assert "allowed are arm" in refused["error"]
