"""ANCF beam, damping models, material updating, comparison, and the renderer of synthetic recordings."""
