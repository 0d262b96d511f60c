"""The fault simulator: core, loop and emulated device against drawn faults, in virtual time."""
