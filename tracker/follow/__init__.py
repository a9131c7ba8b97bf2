"""Tracking of calibrated markers from frame to frame: prediction, registration, recovery, flags."""
