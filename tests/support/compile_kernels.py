"""Compile the kernels that are missing, as the first run of a command does: ``python -m support.compile_kernels``."""

from modalcam.pipeline import GROUPS, Progress, compile_kernels, worker_pool

if __name__ == "__main__":
    with worker_pool(len(GROUPS)) as pool:
        compile_kernels(pool, Progress())
