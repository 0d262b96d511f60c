"""The command `armrig`, and `python -m armrig`: Ctrl-C while it loads ends it in a line, too."""

from __future__ import annotations

import sys


def main() -> int:
    """Load the command line, run it, and return the exit code."""
    try:
        from armrig.cli import main as run
    except KeyboardInterrupt:
        print("armrig: interrupted", file=sys.stderr)
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
