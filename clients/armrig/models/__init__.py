"""Models with their uncertainty and their responses."""
