"""A study told as a document."""
