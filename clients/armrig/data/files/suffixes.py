"""How the names of files end: one table for what reads them and for what is said of them."""

from __future__ import annotations

RECORDING = ".mcap"
TEXT = (".csv", ".tsv", ".txt", ".dat")
ARRAYS = (".mat", ".npz")
DATA = (*TEXT, *ARRAYS)
"""Files of data that are no recording, in small letters."""
OTHER_DATA = "other data (.csv, .dat, .mat, .npz)"
"""What a person is told of them: one of each kind."""
