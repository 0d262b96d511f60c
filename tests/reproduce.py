"""Make the release of HEAD on two empty Debians, and compare the hashes of its files.

`make reproduce`, as root, with Debian's debootstrap. The systems differ in folder, file system,
user, umask, time zone, language and the seed of Python's hashes. They fetch packages: ten minutes.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

from tests.systemd import empty_debian
from tests.systemd.machine import CHECKOUT

PACKAGES = ("ca-certificates", "git", "locales", "make", "python3", "python3-venv")
WITHIN_S = 3600.0
_HASHES = "SHA256SUMS"


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """An empty Debian, and the state in which a user makes the release there."""

    user: str
    folder: str
    in_memory: bool
    """True if the sources are on tmpfs, which lists files in another order than ext4."""
    state: str
    """Lines of the shell before `make release`."""


SYSTEMS = (
    System(
        user="root",
        folder="/root/armrig",
        in_memory=False,
        state="umask 022; export LC_ALL=C.UTF-8 TZ=UTC PYTHONHASHSEED=0",
    ),
    System(
        user="maintainer",
        folder="/srv/sources/of-armrig",
        in_memory=True,
        state="umask 077; export LC_ALL=de_DE.UTF-8 TZ=Asia/Kolkata PYTHONHASHSEED=1",
    ),
)


def main() -> int:
    """Return the exit code: 0 if both systems made the same files."""
    if why := empty_debian.missing():
        print(f"reproduce: {why}: apt install debootstrap, and repeat as root", file=sys.stderr)
        return 1
    made = Path(tempfile.mkdtemp(prefix="armrig-releases-"))
    git = ["git", "-C", CHECKOUT, "rev-parse", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    sums = [_released(x, made / str(number), commit) for number, x in enumerate(SYSTEMS, 1)]
    print(sums[0], end="")
    if sums[0] == sums[1]:
        shutil.rmtree(made)
        return 0
    differ = sorted({line.split()[1] for line in {*sums[0].splitlines()} ^ {*sums[1].splitlines()}})
    print(f"reproduce: compare {', '.join(differ)} in {made}/1 and {made}/2", file=sys.stderr)
    return 1


def _released(system: System, made: Path, commit: str) -> str:
    """Make the release on a system, copy it to a folder, and return its hashes."""
    with tempfile.TemporaryDirectory(prefix="armrig-debian-") as folder:
        root = Path(folder) / "root"
        empty_debian.make(root, *PACKAGES)
        _clone(root / "var" / "armrig.git", commit)
        mount = f"mount -t tmpfs tmpfs {system.folder}" if system.in_memory else ""
        empty_debian.type_in(
            root,
            f"""
            update-ca-certificates >/dev/null
            localedef -i de_DE -f UTF-8 de_DE.UTF-8
            id {system.user} >/dev/null 2>&1 || useradd --create-home {system.user}
            mkdir -p {system.folder} /made
            {mount}
            chown -R {system.user}: {system.folder} /made /var/armrig.git
            su {system.user} -c '
              set -e
              {system.state}
              git clone --quiet /var/armrig.git {system.folder}
              cd {system.folder}
              make release
              cp dist/* /made'
            """,
            within_s=WITHIN_S,
        )
        shutil.copytree(root / "made", made)
    return (made / _HASHES).read_text(encoding="utf-8")


def _clone(folder: Path, commit: str) -> None:
    """Clone a commit, with the tag of its version; both systems need the same commit."""
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    git = ["git", "-C", str(folder)]
    subprocess.run(["git", "clone", "--quiet", "--bare", CHECKOUT, folder], check=True)
    subprocess.run([*git, "update-ref", "HEAD", commit], check=True)
    subprocess.run([*git, "tag", "--force", f"v{project['version']}", commit], check=True)


if __name__ == "__main__":
    sys.exit(main())
