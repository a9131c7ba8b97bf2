"""Frames to marker displacements, each with its standard deviation."""
