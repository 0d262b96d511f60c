"""The equations of the rig: as systems, sampled, integrated numerically, and fitted to data."""
