"""Frequency and damping ratio of a mode as functions of its amplitude."""
