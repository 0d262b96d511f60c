"""The process that drives the rig: it carries out the decisions of the core."""
