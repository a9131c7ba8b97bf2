"""Formats, colours and SVG of the report."""
