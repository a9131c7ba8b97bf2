"""Printable markers and calibration boards."""
