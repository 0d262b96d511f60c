"""The jobs on GitHub run the parts of `.ci/run`, and commands that a checkout has."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="no PyYAML")
ROOT = Path(__file__).parents[2]
WORKFLOW: dict[str, Any] = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
_PART = re.compile(
    r"^(?:[A-Z_]+=\S+ |beside \w+ |sh.*nice -n 19 )*(make [\w-]+|\.ci/\w+)", re.MULTILINE
)


def commands(job: dict[str, Any]) -> list[str]:
    """Return the commands of a job, for each value of its matrix."""
    matrix = job["strategy"]["matrix"]
    found = []
    for step in job["steps"]:
        text = step.get("run", "")
        name = re.fullmatch(r"\$\{\{ matrix\.(\w+) \}\}", text)
        found += matrix[name[1]] if name else text.splitlines()
    return found


HOSTED = [text for job in WORKFLOW["jobs"].values() for text in commands(job)]


@pytest.mark.parametrize("command", sorted(set(HOSTED)))
def test_a_command_is_a_target_of_the_makefile_or_a_script(command: str) -> None:
    program, *words = command.split()
    if program != "make":
        assert re.fullmatch(r"\.ci/\w+", command)
        assert (ROOT / command).is_file()
        return
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w -]+):", makefile, re.MULTILINE))
    assert words[0] in {target for line in targets for target in line.split()}
    assert [word for word in words[1:] if not re.fullmatch(r"[A-Z]+=\w+", word)] == []


def test_each_part_of_the_ci_is_a_command_of_a_job() -> None:
    parts = _PART.findall((ROOT / ".ci/run").read_text(encoding="utf-8"))

    assert len(parts) > 10
    assert set(parts) - {" ".join(command.split()[:2]) for command in HOSTED} == set()


def test_each_python_and_both_processors_run_the_tests() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    matrix = WORKFLOW["jobs"]["everyday"]["strategy"]["matrix"]

    assert f">={matrix['python'][0].rpartition('.')[0]}" == project["requires-python"]
    assert matrix["runner"] == ["ubuntu-24.04", "ubuntu-24.04-arm"]


def test_the_jobs_may_only_read_and_name_the_commit_of_each_action() -> None:
    jobs = WORKFLOW["jobs"].values()
    actions = [step["uses"] for job in jobs for step in job["steps"] if "uses" in step]

    assert WORKFLOW["permissions"] == {"contents": "read"}
    assert [job for job in jobs if "permissions" in job] == []
    assert actions
    assert [x for x in actions if not re.fullmatch(r"actions/\w+@[0-9a-f]{40}", x)] == []


def test_an_image_is_named_by_the_full_version_of_its_python() -> None:
    jobs = WORKFLOW["jobs"]
    versions = jobs["everyday"]["strategy"]["matrix"]["python"]
    images = [job["container"]["image"] for job in jobs.values()]
    named = [image.replace("${{ matrix.python }}", x) for image in images for x in versions]

    assert [x for x in named if not re.fullmatch(r"python:3\.\d+\.\d+-bookworm", x)] == []
