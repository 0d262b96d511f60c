"""The process that drives the rig: it does, and decides nothing."""
