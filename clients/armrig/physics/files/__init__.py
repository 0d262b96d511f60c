"""Files of the arm's motion for other programs."""
