"""Validation: tests of data and of models."""
