"""The host of the service: its processes, the load, systemd, and the disk."""
