"""Fits of the decays of a record, divided until free decays explain each piece."""
