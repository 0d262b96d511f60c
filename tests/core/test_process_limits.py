"""A start with too little address space or too few open files is refused in a sentence."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from armrig_core.errors import OperationError
from armrig_core.process.open_files import require

INFINITE, MIB = resource.RLIM_INFINITY, 1 << 20


def limit(
    monkeypatch: pytest.MonkeyPatch, *, space: int = INFINITE, files: tuple[int, int] = (1024, 4096)
) -> list[tuple[int, int]]:
    """Replace the system's limits; return the list of the limits that are set."""
    found = {resource.RLIMIT_AS: (space, INFINITE), resource.RLIMIT_NOFILE: files}
    given: list[tuple[int, int]] = []

    def change(_: int, limits: tuple[int, int]) -> None:
        given.append(limits)
        found[resource.RLIMIT_NOFILE] = limits

    monkeypatch.setattr(resource, "getrlimit", found.__getitem__)
    monkeypatch.setattr(resource, "setrlimit", change)
    return given


@pytest.mark.parametrize(
    ("space", "files", "said"),
    [
        (512 * MIB, (1024, 4096), ""),
        (INFINITE, (1024, 4096), ""),
        (512 * MIB - 1, (1024, 4096), r"limited to 511 MiB, armrig status needs 512 MiB: "),
        (INFINITE, (10, 20), r"limited to 20, .* needs 32: .*`ulimit -n 32`"),
    ],
)
def test_a_program_with_too_low_a_limit_is_refused_with_the_remedy(
    space: int, files: tuple[int, int], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit(monkeypatch, space=space, files=files)

    with pytest.raises(OperationError, match=said) if said else nullcontext():
        require("armrig status", memory_mib=512, files=32)


@pytest.mark.parametrize(
    ("files", "set_to"), [((32, 32), []), ((10, 32), [(32, 32)]), ((INFINITE, INFINITE), [])]
)
def test_the_limit_on_open_files_is_raised_only_as_far_as_necessary(
    files: tuple[int, int], set_to: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = limit(monkeypatch, files=files)

    require("armrig status", memory_mib=512, files=32)

    assert given == set_to


def _limited(ulimit: str, *arguments: str, folder: Path) -> tuple[int, list[str]]:
    """Run a program in a shell with a limit; return its exit code and its lines."""
    done = subprocess.run(
        ["sh", "-c", f'ulimit {ulimit}; exec "$@"', "sh", sys.executable, "-m", *arguments],
        env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, (done.stderr + done.stdout).splitlines()


@pytest.mark.parametrize(
    ("program", "arguments", "code", "ulimit"),
    [
        ("armrigd run", ["armrig_daemon", "run", "--emulate"], 78, "-v 300000"),
        ("armrigd emulate", ["armrig_daemon", "emulate", "--port", "unix:none"], 78, "-n 10"),
        ("armrig lab", ["armrig", "lab", "--json"], 1, "-n 10"),
        ("armrig dashboard", ["armrig", "dashboard", "--json"], 1, "-v 300000"),
        ("armrig collect", ["armrig", "collect", "step"], 1, "-n 10"),
    ],
)
def test_a_limit_that_would_fail_later_is_refused_at_the_start(
    program: str, arguments: list[str], code: int, ulimit: str, tmp_path: Path
) -> None:
    done, lines = _limited(ulimit, *arguments, folder=tmp_path)

    assert (done, len(lines)) == (code, 1)
    assert f"{program} needs" in lines[0]


@pytest.mark.parametrize("ulimit", ["-v 100000", "-n 10"])
def test_a_stop_is_sent_at_any_limit(ulimit: str, tmp_path: Path) -> None:
    """The port does not exist, so both programs have tried to stop the motor."""
    code, lines = _limited(
        ulimit, "armrig_daemon", "estop", "--port", str(tmp_path / "none"), folder=tmp_path
    )
    _, stop = _limited(ulimit, "armrig", "stop", folder=tmp_path)

    assert (code, len(lines)) == (1, 1)
    assert "cannot be opened" in lines[0]
    assert "armrig stop needs" in stop[0]
    assert len(stop) > 1


def test_the_help_is_printed_with_any_limit(tmp_path: Path) -> None:
    assert _limited("-n 10", "armrig", "lab", "--help", folder=tmp_path)[0] == 0
