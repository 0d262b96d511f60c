"""From the MCAP file to angles on a complete grid, and what that is good for."""
