"""One task for thousands of recordings: a row of a table for each, resumable, on many machines."""
