"""The daemon of a rig: the loop that drives the rig, and the service that publishes and records."""
