"""A plant behind a pseudo-terminal that answers as the real rig does."""
