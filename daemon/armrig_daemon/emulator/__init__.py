"""Emulated rig: a program at a pseudo-terminal or a socket that answers like the real rig."""
