"""The decisions of the daemon: pure functions without a clock, randomness or a log."""
