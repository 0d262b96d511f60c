"""What decides: pure, without a clock, randomness or a log."""
