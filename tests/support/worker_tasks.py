"""Tasks that fail in different ways; in a module that worker processes can import."""

import os
import signal
import time
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np

GIBI = 2**30


def behave(task):
    """Do what the first word of the task requests; return it in capitals, with the number of BLAS threads."""
    word, *more = task.split()
    if word == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if word == "die-once" and not Path(more[0]).exists():
        Path(more[0]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if word == "raise":
        msg = "broken task"
        raise RuntimeError(msg)
    if word == "hang":
        time.sleep(600)
    if word == "wait-for":
        while not Path(more[0]).exists():
            time.sleep(0.01)
    if word == "own-timeout":
        raise TimeoutError(word)
    if word == "allocate":
        return str(np.ones(int(float(more[0]) * GIBI), dtype=np.uint8).size), str(os.getpid())
    return word.upper(), os.environ["OMP_NUM_THREADS"]


class Inline(Executor):
    """Run tasks immediately in this process; errors are raised or, with `errors`, stored in the future."""

    def __init__(self, *, errors=False):
        self.errors = errors

    def submit(self, fn, /, *args, **kwargs):
        """Run the call."""
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except RuntimeError as error:
            if not self.errors:
                raise
            future.set_exception(error)
        return future


class InThisProcess(Inline):
    """Executor in the place of worker processes: the whole command runs in one process with limits."""

    def __init__(self, *_):
        super().__init__()

    def kill(self):
        """No process of its own is to be killed."""

    def close(self, *, drop=False):
        """Nor is one to be ended."""

    def renew(self):
        """Nor replaced."""


def counted(recording, seen, progress):
    """Work on 20 frames of 30 and wait until the listener has noticed and made the file `seen`."""
    for done in range(1, 21):
        progress(done, 30)
    while not Path(seen).exists():
        time.sleep(0.01)
    return recording.name
