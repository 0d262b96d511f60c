"""`armrigd`, but a run named `unrecorded` is not recorded: what `recording_pauses.py` compares.

Its messages go to the recorder's thread as ever, which drops them: no bytes, no file, no disk.
"""

from __future__ import annotations

from armrig_core.recording_file.recorder import Recording
from armrig_daemon.command_line import app
from armrig_daemon.service import runs

UNRECORDED = "unrecorded"


class Switched(Recording):
    """A recording that may write nothing."""

    def _write_run(self) -> None:
        if self._part.manifest.experiment != UNRECORDED:
            super()._write_run()
            return
        self._part.discard()
        while not isinstance(batch := self._queue.get(), str):
            self._written += sum(message.stream == "sample" for message in batch)
        self.synced = self._written


if __name__ == "__main__":
    runs.Recording = Switched  # type: ignore[misc]
    app(prog_name="armrigd")
