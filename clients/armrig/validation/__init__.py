"""Whether a model and its data can be trusted."""
