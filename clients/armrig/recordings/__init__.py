"""Recordings: from an MCAP file to angles on a complete grid, and checks of their quality."""
