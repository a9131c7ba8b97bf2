"""Files of OUT for other programs."""
