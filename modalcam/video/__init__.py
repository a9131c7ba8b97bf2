"""Footage of the simulated beam, and footage with the tracks drawn in."""
