"""The locked versions with hashes are those that pyproject.toml requires."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest

requirements = pytest.importorskip("packaging.requirements")
ROOT = Path(__file__).parents[2]
LOCKS = {
    "application": ROOT / "requirements.lock",
    "dev": ROOT / "tests" / "requirements.lock",
    "build": ROOT / "requirements.build.lock",
}
BUILD = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
_PINNED = re.compile(
    r"^([a-z0-9.-]+)(\[[a-z0-9,-]+\])?==(\S+)(?: ; (.+?))? \\\n"
    r"((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)",
    re.MULTILINE,
)


def pinned(path: Path) -> dict[str, set[str]]:
    """Return the versions of each package; it has two where they hang on the Python."""
    found: dict[str, set[str]] = {}
    for name, _, version, _, _ in _PINNED.findall(path.read_text()):
        found.setdefault(name, set()).add(version)
    return found


def asked_for(*extras: str) -> list[str]:
    """Return the requirements of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    more = [text for extra in extras for text in project["optional-dependencies"][extra]]
    return [*project["dependencies"], *more]


@pytest.mark.parametrize("lock", LOCKS)
def test_every_line_of_a_lock_file_is_a_version_with_hashes(lock: str) -> None:
    text = LOCKS[lock].read_text()
    assert _PINNED.sub("", text).strip() == ""
    assert len(pinned(LOCKS[lock])) > (4 if lock == "build" else 30)


@pytest.mark.parametrize(
    ("lock", "extras"), [("application", ()), ("dev", ("dev",)), ("build", None)]
)
def test_every_required_package_is_locked_within_its_bounds(
    lock: str, extras: tuple[str, ...] | None
) -> None:
    """`make lock` was run after the last change of a dependency."""
    versions = pinned(LOCKS[lock])
    for text in BUILD if extras is None else asked_for(*extras):
        asked = requirements.Requirement(text)
        name = asked.name.lower().replace("_", "-")
        assert name in versions, f"{name}: make lock"
        for version in versions[name]:
            assert asked.specifier.contains(version), f"{name} {version}: make lock"


def test_an_extra_that_a_locked_package_requires_is_locked_with_its_version() -> None:
    """An older pip refuses a lock without it once a newer version of the package is out."""
    locked = {
        name: set(extras.strip("[]").split(","))
        for name, extras, *_ in _PINNED.findall(LOCKS["dev"].read_text())
    }
    required = [
        (package.name, asked.name.lower().replace("_", "-"), asked.extras)
        for package in importlib.metadata.distributions()
        for asked in map(requirements.Requirement, package.requires or [])
        if package.name.lower().replace("_", "-") in locked
        if asked.marker is None or asked.marker.evaluate({"extra": ""})
    ]
    missing = [line for line in required if line[2] and not line[2] <= locked.get(line[1], set())]
    assert any(extras for _, _, extras in required)
    assert missing == []


def test_tests_run_with_the_versions_of_an_installation() -> None:
    application, dev, build = (pinned(LOCKS[lock]) for lock in ("application", "dev", "build"))
    for locked in (application, build):
        assert {name: dev.get(name) for name in locked} == locked
