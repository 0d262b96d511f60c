"""Stalls of the host during tests that drive an emulated rig in real time."""
