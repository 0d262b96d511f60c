"""Advice on data and on models, in words."""
