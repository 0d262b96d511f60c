"""An emulated rig at a pseudo-terminal or a socket, which answers as the real rig does."""
