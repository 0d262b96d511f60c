"""The recorder of one rig: it asks for what was published, and writes it, until told to end."""

from __future__ import annotations

import time
from typing import Protocol

import zenoh

from armrig.rig.remote_recording import RemoteRecording
from armrig.rig.remote_source import RemoteSource
from armrig.rig.session import service_has_stopped

_ASK_S = 0.2
_SILENCE_S = 2.0
_MOST_PIECES = 64


class Ended(Protocol):
    """What ends a recorder: signals, or an Event of another thread."""

    def is_set(self) -> bool:
        """Return whether it is to end."""

    def wait(self, timeout: float) -> bool:
        """Wait for that, for `timeout` seconds at most; return whether it is to end."""


class RemoteRecorder:
    """Brings what a source has into a recording."""

    def __init__(self, session: zenoh.Session, recording: RemoteRecording) -> None:
        """Ask nothing yet."""
        self.recording = recording
        self._row = RemoteSource(session, recording.rig)

    def begin(self) -> bool:
        """Record the oldest that is kept; return whether the rig answers.

        Raises
        ------
        RigError
            What answers is no armrigd, or nothing can be written.
        """
        piece = self._row.next_piece()
        if piece is not None:
            self.recording.add(piece)
        return piece is not None

    def record(self, ended: Ended, seconds: float | None = None) -> None:
        """Record until `ended` is set, or for `seconds`, and then what was published until then.

        Raises
        ------
        RigError
            What answers is no armrigd, or nothing more can be written.
        """
        rig, tell = self.recording.rig, self.recording.tell
        stopped = service_has_stopped(rig, self.recording.endpoint)
        begun = heard = time.monotonic()
        silent = False
        while not ended.is_set() and (seconds is None or time.monotonic() - begun < seconds):
            piece = self._row.next_piece()
            now = time.monotonic()
            if piece is None:
                if now - heard > _SILENCE_S and not silent:
                    tell(f"{stopped or f'rig {rig} does not answer'}; waiting for it")
                    silent = True
                ended.wait(_ASK_S)
                continue
            if silent:
                tell(f"rig {rig} answers again, after {now - heard:.1f} s")
            elif piece.is_new_life and stopped:
                tell(stopped)
            heard, silent = now, False
            self.recording.add(piece)
            if not piece.is_full:  # else there is more
                ended.wait(_ASK_S)
        self._catch_up()

    def _catch_up(self) -> None:
        """Record what has been published up to now; no more than a daemon keeps."""
        for _ in range(_MOST_PIECES):
            piece = self._row.next_piece()
            if piece is None:
                break
            self.recording.add(piece)
            if not piece.is_full:
                break
