"""The rig interface daemon: the loop that drives the rig, and the service around it."""
