"""A program: a pseudo-terminal that answers each request of fixed length with a fixed answer.

It replaces the emulator for the bare loop: the same lengths on the same kind of line, at the same
priority, without any computation.
"""

from __future__ import annotations

import os
import pty
import tty

from armrig_protocol.frame import wire_length
from armrig_protocol.messages import Exchange, Sample

from tests.benchmarks.host_timing.kernel import be_punctual, end_with_parent

REQUEST_LENGTH, ANSWER_LENGTH = wire_length(Exchange), wire_length(Sample)
PRIORITY = 20  # the emulator's


def main() -> None:
    """Print the port, then answer until the parent ends."""
    end_with_parent()
    master, slave = pty.openpty()
    tty.setraw(slave)  # kept open, or the master would see the end of it between two openings
    print(os.ttyname(slave), flush=True)
    be_punctual(PRIORITY)
    answer, received = bytes(ANSWER_LENGTH), 0
    while True:
        received += len(os.read(master, 4096))
        while received >= REQUEST_LENGTH:
            received -= REQUEST_LENGTH
            os.write(master, answer)


if __name__ == "__main__":
    main()
