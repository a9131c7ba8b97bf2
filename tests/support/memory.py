"""Memory of a call, as tracemalloc counts it."""

import tracemalloc


def peak_of(call):
    """Most bytes that the call held at a time, and its result."""
    tracemalloc.start()
    try:
        result = call()
        return tracemalloc.get_traced_memory()[1], result
    finally:
        tracemalloc.stop()
