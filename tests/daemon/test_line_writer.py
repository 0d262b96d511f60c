"""No caller waits for the lines of a `LineWriter`."""

import os
import threading
import time

from armrig_core.process.line_writer import QUEUE, LineWriter


def test_a_terminal_that_stands_still_drops_lines_and_their_number_is_said() -> None:
    moves, written = threading.Event(), list[str]()
    lines = LineWriter(lambda line: (moves.wait(60), written.append(line))[1])

    for n in range(QUEUE + 8):  # the first may be with the writer, so that 7 or 8 find no room
        lines.put(f"line {n}")
    begun = time.monotonic()
    lines.close(0.05)
    took_s = time.monotonic() - begun
    moves.set()
    lines.put("later")
    lines.close(60)

    assert not written or took_s < 30
    assert written[:2] == ["line 0", "line 1"]
    assert any("dropped, because the output stood still" in line for line in written)


def test_the_last_lines_of_another_process_are_written_before_the_end() -> None:
    written: list[str] = []
    lines = LineWriter(written.append)

    end = lines.relay()
    os.write(end, b"a traceback\n\xff no line break")
    os.close(end)
    lines.close(60)

    assert written == ["a traceback", "\ufffd no line break"]
