"""Estimators for several inputs and outputs."""
