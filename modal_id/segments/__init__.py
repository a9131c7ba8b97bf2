"""Onset of the free decay."""
