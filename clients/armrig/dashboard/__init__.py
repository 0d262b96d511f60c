"""One page over a live rig: a server on this machine, and what a browser shows."""
