"""Benchmarks against other current tools, run with ``python -m benchmarks.NAME``."""
