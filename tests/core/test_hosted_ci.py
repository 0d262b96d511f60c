"""The jobs on GitHub run the parts of `.ci/run`, and commands that a checkout has."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="no PyYAML")
ROOT = Path(__file__).parents[2]
WORKFLOWS: list[dict[str, Any]] = [
    yaml.safe_load(path.read_text()) for path in (ROOT / ".github/workflows").iterdir()
]
JOBS: dict[str, Any] = {
    name: job for workflow in WORKFLOWS for name, job in workflow["jobs"].items()
}
_COMMAND = re.compile(r"\bmake \w[\w-]*|\.ci/\w+")


def commands(job: dict[str, Any]) -> list[str]:
    """Return the commands of a job, for each value of its matrix."""
    parts = job.get("strategy", {"matrix": {}})["matrix"].get("part", [])
    return _COMMAND.findall("\n".join([*(step.get("run", "") for step in job["steps"]), *parts]))


HOSTED = {command for job in JOBS.values() for command in commands(job)}


def test_each_command_is_a_target_of_the_makefile_or_a_script() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    lines = re.findall(r"^([\w -]+):", makefile, re.MULTILINE)
    targets = {f"make {target}" for line in lines for target in line.split()}

    assert {command for command in HOSTED if not (ROOT / command).is_file()} <= targets


def test_each_part_of_the_ci_is_a_command_of_a_job() -> None:
    script = re.sub(r"^ *#.*", "", (ROOT / ".ci/run").read_text(), flags=re.MULTILINE)
    parts = {*_COMMAND.findall(script)}

    assert {"make exhaustive", "make timed"} <= parts
    assert parts - HOSTED == {"make exhaustive", "make timed"}  # `make test-all` is both
    assert "make test-all" in HOSTED


def test_each_python_and_both_processors_run_the_tests() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    matrix = JOBS["everyday"]["strategy"]["matrix"]

    assert f">={matrix['python'][0].rpartition('.')[0]}" == project["requires-python"]
    assert matrix["runner"] == ["ubuntu-24.04", "ubuntu-24.04-arm"]


def test_the_jobs_may_only_read_and_name_the_versions_of_actions_and_images() -> None:
    actions = [step["uses"] for job in JOBS.values() for step in job["steps"] if "uses" in step]
    images = [job["container"]["image"] for job in JOBS.values()]
    versions = JOBS["everyday"]["strategy"]["matrix"]["python"]

    assert [workflow["permissions"] for workflow in WORKFLOWS] == [{"contents": "read"}] * 2
    assert [name for name, job in JOBS.items() if "permissions" in job] == []
    assert [x for x in actions if not re.fullmatch(r"actions/\w+@[0-9a-f]{40}", x)] == []
    for image in (image.replace("${{ matrix.python }}", x) for image in images for x in versions):
        assert re.fullmatch(r"python:3\.\d+\.\d+-bookworm", image)
