"""Models with several inputs and outputs."""
