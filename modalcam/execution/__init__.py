"""Processes that compute, on this machine or on a cluster, and how they report progress."""
