"""Readers of recordings: one module each, behind the protocol of `tracker.video.base`."""
