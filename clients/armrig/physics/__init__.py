"""The rig's equations: as systems, sampled, integrated and fitted to data."""
