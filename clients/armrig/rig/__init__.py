"""What opens a session to a daemon, or measures this host."""
