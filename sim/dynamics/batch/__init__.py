"""Many damping models, frequencies and starts of one beam at once."""
