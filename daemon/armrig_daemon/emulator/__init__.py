"""A plant behind a pseudo-terminal or a socket that answers as the real rig does."""
