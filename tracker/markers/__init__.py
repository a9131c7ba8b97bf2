"""Kinds of markers: one module each, behind the protocol of `tracker.markers.base`."""
