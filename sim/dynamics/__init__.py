"""Motion of the beam in time."""
