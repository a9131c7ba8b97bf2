"""Posterior of the frequency and the damping ratio of each mode."""
