"""What the service needs of its host: its processes, the load, systemd, and the disk."""
