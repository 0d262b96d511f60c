"""A program: try SCHED_FIFO and mlockall, and print what was granted as `1 0`.

A process of its own, for neither can be asked about without getting it.
"""

from __future__ import annotations

import sys

from armrig.rig.bench.kernel import lock_memory, set_fifo


def main() -> None:
    """Try both."""
    print(int(set_fifo(int(sys.argv[1]))), int(lock_memory()))


if __name__ == "__main__":
    main()
