"""The suite under disturbance."""
