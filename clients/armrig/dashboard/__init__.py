"""Dashboard of a live rig: a server on this machine, and the page that a browser shows."""
