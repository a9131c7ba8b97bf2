"""The position of a marker in one frame, with its standard deviation."""
