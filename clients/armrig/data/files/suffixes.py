"""Suffixes of file names, used by the loaders and in messages."""

from __future__ import annotations

RECORDING = ".mcap"
DATA = (".csv", ".tsv", ".txt", ".dat", ".mat", ".npz", ".parquet")
"""Usual suffixes of data files other than recordings; the readers look at the content instead."""
OTHER_DATA = "other data (.csv, .dat, .mat, .npz)"
"""Name of the data files in messages, with their usual suffixes."""
