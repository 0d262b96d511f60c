"""The file of a recording, for daemon and clients: its records, its lock, how it is completed."""
