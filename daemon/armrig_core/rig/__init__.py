"""The rig: the arm, its voltages and calibration, its firmware, and its emulation."""
