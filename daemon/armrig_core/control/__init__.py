"""Control laws as data, and their evaluation."""
