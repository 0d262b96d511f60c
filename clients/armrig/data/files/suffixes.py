"""Suffixes of file names, used by the loaders and in messages."""

from __future__ import annotations

RECORDING = ".mcap"
TEXT = (".csv", ".tsv", ".txt", ".dat")
ARRAYS = (".mat", ".npz")
DATA = (*TEXT, *ARRAYS)
"""Suffixes of data files other than recordings, in lower case."""
OTHER_DATA = "other data (.csv, .dat, .mat, .npz)"
"""Name of the data files in messages, with their usual suffixes."""
