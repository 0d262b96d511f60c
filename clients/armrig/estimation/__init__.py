"""Estimators of parametric models, one module for each, and the search that they share."""
