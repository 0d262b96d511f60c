"""What data say before a structure is chosen: impulse, frequency and step responses."""
