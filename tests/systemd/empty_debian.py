"""The root of an empty Debian 12, as debootstrap makes it, with this checkout laid into it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from tests.systemd.machine import CHECKOUT, FETCHED_S

SUITE = "bookworm"
_AUTHORITIES = Path("usr/local/share/ca-certificates")
"""Certificates of this host's network, if it has its own, for the packages of Debian."""
_NOT_SOURCES = (".git", ".venv", ".mypy_cache", ".ruff_cache", ".pytest_cache", "node_modules")


def missing() -> str:
    """Return the reason why there can be no such root here, or nothing."""
    return "" if shutil.which("debootstrap") else "debootstrap is not installed"


def make(root: Path, *needed: str) -> None:
    """Make a root of Debian's smallest variant, with the packages that a test needs."""
    packages = ",".join(needed)
    _run("debootstrap", "--variant=minbase", f"--include={packages}", SUITE, str(root))
    if ("/" / _AUTHORITIES).is_dir():
        shutil.copytree("/" / _AUTHORITIES, root / _AUTHORITIES, dirs_exist_ok=True)


def lay_checkout(folder: Path) -> None:
    """Copy the sources, as a person unpacks them."""
    shutil.copytree(CHECKOUT, folder, ignore=shutil.ignore_patterns(*_NOT_SOURCES))


def type_in(root: Path, text: str, *, within_s: float = FETCHED_S) -> None:
    """Type lines as root, before any systemd is there; what they install starts nothing."""
    policy = root / "usr/sbin/policy-rc.d"  # Debian's way to say so
    policy.write_text("#!/bin/sh\nexit 101\n")
    policy.chmod(0o755)
    shell = f'mount -t proc proc {root}/proc; exec chroot {root} sh -ec "$1"'
    _run(
        *("unshare", "--mount", "--pid", "--fork", "--kill-child"),
        *("sh", "-ec", shell, "sh", text),
        within_s=within_s,
    )
    policy.unlink()


def _run(*command: str, within_s: float = FETCHED_S) -> None:
    clean = {"PATH": os.environ["PATH"], "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    done = subprocess.run(
        command,
        env=clean,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=within_s,
        check=False,
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr}"
