"""Estimators of parametric models, one module each, and the numerical work they share."""
