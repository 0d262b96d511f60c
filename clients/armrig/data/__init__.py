"""Data for identification, and their treatment."""
