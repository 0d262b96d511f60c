"""Whether the rig ran in open loop, and whether it has a pure delay (handout 3.7 and 3.8)."""
