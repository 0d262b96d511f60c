"""Whether a device does what PROTOCOL.md says: its rules as a list, tried over a line."""
