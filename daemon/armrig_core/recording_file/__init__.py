"""Reading, writing, locking and completing the file of a recording."""
