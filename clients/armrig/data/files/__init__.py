"""Readers of files of data, and the suffixes of the names of files."""

RECORDING = ".mcap"
DATA = (".csv", ".tsv", ".txt", ".dat", ".mat", ".npz", ".parquet")
"""Usual suffixes of data files other than recordings; the readers look at the content instead."""
OTHER_DATA = "other data (.csv, .dat, .mat, .npz)"
"""Name of the data files in messages, with their usual suffixes."""
IMPORTED = "imported"
"""Kind of the recordings that `armrig import` writes."""
