"""Validation of models with several inputs and outputs."""
