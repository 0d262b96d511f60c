"""Audit the locked packages for known vulnerabilities (`make audit`).

pip-audit skips a package that the index does not know, and exits with 0 even if it skipped all
packages. The exit code of this program is 0 without a vulnerability, 1 with a vulnerability, and
3 if nothing was audited.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

NOTHING = 3
PROGRAM = [str(Path(sys.executable).with_name("pip-audit")), "--disable-pip", "--require-hashes"]


def main(program: Sequence[str]) -> int:
    """Print the vulnerabilities and the number of the audited packages; return the exit code."""
    files = [name for file in sys.argv[1:] for name in ("-r", file)]
    done = subprocess.run([*program, "-f", "json", *files], capture_output=True, check=False)
    if done.returncode not in (0, 1) or not done.stdout:
        sys.stderr.buffer.write(done.stderr)
        return done.returncode or 1
    found = json.loads(done.stdout)["dependencies"]
    audited = [package for package in found if "skip_reason" not in package]
    for package in audited:
        for known in package["vulns"]:
            fixed = ", ".join(known["fix_versions"]) or "no version"
            print(f"{package['name']} {package['version']}: {known['id']}, fixed in {fixed}")
    if not audited:
        print(f"nothing was audited: the index knows none of {len(found)} packages")
        return NOTHING
    print(f"{len(audited)} of {len(found)} packages were audited")
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(PROGRAM))
