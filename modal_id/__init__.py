"""Displacement series to modal parameters and their posterior (Eq. 1, Eq. 2, emcee)."""
