"""Compile the kernels that are missing, as the first run of a command does: ``python -m support.compile_kernels``."""

from modalcam.execution import Progress, worker_pool
from modalcam.pipeline import GROUPS, compile_kernels

if __name__ == "__main__":
    with worker_pool(len(GROUPS)) as pool:
        compile_kernels(pool, Progress())
