"""Stages of a run and their results."""
