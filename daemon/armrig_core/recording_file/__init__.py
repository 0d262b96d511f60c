"""The file of a recording, for daemon and clients: its records, its lock, its completion."""
