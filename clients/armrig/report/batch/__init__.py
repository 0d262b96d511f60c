"""One task for many recordings: a table with a row per recording, resumable, on many machines."""
