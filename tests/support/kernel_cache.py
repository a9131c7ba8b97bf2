"""Kernels that numba loads from its cache and saves there, by what it reports of other processes."""

import os
import re
import subprocess
import sys

from support.paths import ROOT

_REPORT = re.compile(
    r"\[cache\] data (?P<what>loaded from|saved to) '.*/(?P<kernel>[^/]+)-\d+\.py\d+\.\d+\.nbc'"
)


def python(code, **variables):
    """Standard output of another process that runs the code."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])} | variables
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], check=False, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def kernels(report, *keys):
    """Kernels, each as file and function, of the report under ``NUMBA_DEBUG_CACHE=1``; loaded and saved by default."""
    wanted = keys or ("loaded from", "saved to")
    return {found["kernel"] for found in _REPORT.finditer(report) if found["what"] in wanted}


def listed(*groups):
    """Names of the kernels of groups as in a report."""
    return {kernel.rpartition(".")[2].replace(":", ".") for group in groups for kernel in group.called}
