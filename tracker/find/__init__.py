"""Finders: where the markers are in a frame, by kind."""
