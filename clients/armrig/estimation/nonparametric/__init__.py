"""Nonparametric estimates of impulse, frequency and step responses."""
