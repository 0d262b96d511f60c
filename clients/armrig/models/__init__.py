"""A model, how sure it is, and what it answers."""
