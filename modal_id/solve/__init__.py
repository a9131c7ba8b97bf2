"""Weighted linear least squares of decaying modes on a spline baseline, and the fit of their poles (Eq. 1, 2)."""
