"""The command `armrigd`, and `python -m armrig_daemon`: Ctrl-C while it loads ends it in a line."""

from __future__ import annotations

import sys


def main() -> None:
    """Load the command line and run it."""
    try:
        from armrig_daemon.command_line import app

        app()
    except KeyboardInterrupt:
        print("armrigd: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        exec("")  # as in armrig/__main__.py: else Python may end itself by SIGINT


if __name__ == "__main__":
    main()
