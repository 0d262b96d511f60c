"""`make release` refuses a commit that is no release, in one line that names the way out."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="no git: apt install git")
ROOT = Path(__file__).parents[2]
CHANGELOG = "# Changelog\n\n## Unreleased\n\n## 1.2.0 - 2026-11-23\n\n### Added\n- One.\n"
CITATION = "version: 1.2.0\ndate-released: 2026-11-23\n"
PYPROJECT = '[project]\nname = "armrig"\nversion = "1.2.0"\n'
ENVIRONMENT = {
    **os.environ,
    "GIT_CONFIG_GLOBAL": "/dev/null",
    "GIT_CONFIG_NOSYSTEM": "1",
    **{
        f"GIT_{role}_{what}": value
        for role in ("AUTHOR", "COMMITTER")
        for what, value in (("NAME", "A"), ("EMAIL", "a@b"))
    },
}


class Sources:
    """A repository with the script and the files that the script reads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / ".ci").mkdir()
        shutil.copy(ROOT / ".ci" / "release", folder / ".ci")
        self.write(".gitignore", "/dist/\n")
        self.write("CHANGELOG.md", CHANGELOG)
        self.write("CITATION.cff", CITATION)
        self.write("pyproject.toml", PYPROJECT)
        self.git("init")
        self.commit()

    def write(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text)

    def git(self, *words: str) -> None:
        subprocess.run(
            ["git", *words],
            cwd=self.folder,
            env=ENVIRONMENT,
            capture_output=True,
            check=True,
        )

    def commit(self) -> None:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", "a commit")

    def refusal(self) -> str:
        """Return the line of the refusal; "" if the script refuses nothing and starts to build."""
        done = subprocess.run(
            [".ci/release"],
            cwd=self.folder,
            env=ENVIRONMENT,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode != 0
        if ".ci/build: No such file" in done.stderr:
            return ""
        (line,) = done.stderr.splitlines()
        assert done.stdout == ""
        return line.removeprefix("release: ")


@pytest.fixture
def sources(tmp_path: Path) -> Sources:
    """Give the sources of a release whose tag is missing."""
    return Sources(tmp_path)


def test_a_tagged_commit_is_released(sources: Sources) -> None:
    sources.git("tag", "v1.2.0")
    (sources.folder / "dist").mkdir()
    sources.write("dist/armrig.whl", "of an earlier release")

    assert sources.refusal() == ""


@pytest.mark.parametrize(
    ("tag", "later", "refusal"),
    [
        ("reviewed", False, 'HEAD has no tag: type "git tag v1.2.0"'),
        (
            "v1.3.0",
            False,
            "HEAD has the tag v1.3.0, but pyproject.toml has version 1.2.0: correct the version "
            "and commit, or remove the tag",
        ),
        (
            "v1.2.0",
            True,
            'v1.2.0 is another commit: type "git checkout v1.2.0", or write the next version into '
            "pyproject.toml",
        ),
    ],
)
def test_a_commit_without_its_tag_is_refused(
    sources: Sources, tag: str, later: bool, refusal: str
) -> None:
    sources.git("tag", tag)
    if later:
        sources.commit()

    assert sources.refusal() == refusal


def test_a_folder_in_the_clone_of_another_project_is_refused(sources: Sources) -> None:
    inner = sources.folder / "unpacked"
    inner.mkdir()
    unpacked = Sources(inner)
    shutil.rmtree(inner / ".git")

    assert unpacked.refusal() == (
        "this folder is not a clone: clone the repository, and repeat this command there"
    )


@pytest.mark.parametrize("name", ["CHANGELOG.md", "note.txt"])
def test_an_uncommitted_file_is_refused(sources: Sources, name: str) -> None:
    """A file that only the user's own settings ignore counts: the source archive contains it."""
    sources.git("tag", "v1.2.0")
    (sources.folder / ".git" / "info" / "exclude").write_text("note.txt\n")
    sources.write(name, "new")

    assert sources.refusal() == (
        f'{name} is not as committed: commit or remove each file that "git status" lists'
    )


@pytest.mark.parametrize(
    ("name", "text", "refusal"),
    [
        (
            "CHANGELOG.md",
            "## 1.2.0\n- One.\n",
            'CHANGELOG.md has no heading "## 1.2.0 - YYYY-MM-DD": write this section and ',
        ),
        (
            "CHANGELOG.md",
            "## 1.2.0 - 2026-11-23\n\n## 1.1.0 - 2026-10-01\n- One.\n",
            "the section 1.2.0 of CHANGELOG.md is empty: list the changes and ",
        ),
        (
            "CHANGELOG.md",
            CHANGELOG.replace("## 1.2.0", "- Two.\n\n## 1.2.0"),
            'CHANGELOG.md has entries under "Unreleased": move the entries to 1.2.0 and ',
        ),
        *(
            (
                "CITATION.cff",
                CITATION.replace(line, f"{line}9"),
                f'CITATION.cff has no line "{line}": write this line and ',
            )
            for line in CITATION.splitlines()
        ),
    ],
)
def test_a_changelog_or_a_citation_of_another_release_is_refused(
    sources: Sources, name: str, text: str, refusal: str
) -> None:
    sources.write(name, text)
    sources.commit()

    assert sources.refusal() == f"{refusal}commit"
    sources.git("tag", "v1.2.0")
    assert sources.refusal() == f'{refusal}commit, and type "git tag --force v1.2.0"'


def test_the_citation_names_the_newest_release() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    version, date = re.findall(r"^## (\S+) - (\S+)$", changelog, re.MULTILINE)[0]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()

    assert {f"version: {version}", f"date-released: {date}"} <= set(citation)


def test_the_version_is_the_newest_release_or_one_in_development() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")

    newest = re.findall(r"^## (\S+) - ", changelog, re.MULTILINE)[0]
    assert project["version"] == newest or project["version"].endswith(".dev0")
