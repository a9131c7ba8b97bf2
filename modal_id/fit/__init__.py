"""Least squares of decaying modes (Eq. 1, 2)."""
