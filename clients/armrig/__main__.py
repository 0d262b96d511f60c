"""The command `armrig`, also `python -m armrig`; after Ctrl-C it prints one line and ends."""

from __future__ import annotations

import sys

from armrig_core.process.loading import end_at_ctrl_c


def main() -> int:
    """Load the command line, run it, and return the exit code."""
    has_loaded = end_at_ctrl_c("armrig")
    from armrig.cli import load
    from armrig.cli import main as run

    load(sys.argv[1:])
    has_loaded()
    try:
        return run()
    except KeyboardInterrupt:
        print("armrig: interrupted", file=sys.stderr)
        return 130
    finally:
        # If a KeyboardInterrupt occurs inside `exec`, as dataclasses use it, Python later ends
        # itself by SIGINT and ignores the exit code. The next `exec` resets this state.
        exec("")


if __name__ == "__main__":
    sys.exit(main())
