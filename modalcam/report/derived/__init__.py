"""Quantities that the report derives from the results: signals of one mode, scatter of tracks, thinned traces."""
