"""Data to identify from, and their treatment."""
