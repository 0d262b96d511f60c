"""Equations of the rig: systems, sampled models, numerical integration, and fits to data."""
