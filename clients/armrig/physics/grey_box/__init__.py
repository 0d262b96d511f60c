"""Estimates of physical parameters, an independent check, a split study (handout 3.5, 3.6)."""
