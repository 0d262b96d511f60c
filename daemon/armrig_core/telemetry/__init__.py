"""The messages of a rig: their names, their layout, and the recent ones."""
