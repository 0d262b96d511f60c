"""What a colleague would say of data or of a model, in words."""
