"""Benchmarks, ``python -m benchmarks.NAME``: each is one run that holds today's best tools beside us."""
