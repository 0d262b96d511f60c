"""The decisions: pure functions without a clock, randomness or a log."""
