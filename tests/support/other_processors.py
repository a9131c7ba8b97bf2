"""The numerical tests under the kernels of other processors: ``python -m support.other_processors``.

BLAS chooses its kernels, and numba its instructions, for the processor that they run on. Each environment runs the
tests below, and computes the values of `numerical_values`, which must agree with those of this processor within the
digits that ``docs/files.md`` promises.
"""

import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy._core._multiarray_umath import __cpu_features__
from support.paths import ROOT

# Kernel of OpenBLAS and the instructions without which it stops the process. Other platforms than x86-64 have none of
# them, and other kernels.
BLAS_KERNELS = {"Prescott": "SSE3", "Haswell": "AVX2", "Zen": "AVX2", "SkylakeX": "AVX512_SKX"}
TESTS = (
    "tests/sim/beam",
    "tests/sim/test_real_beams.py",
    "tests/sim/render/test_sample_videos.py::test_truth_matches_the_simulated_beam",
    "tests/modal_id/test_fit_free_decay.py",
    "tests/modal_id/posterior/test_cramer_rao.py",
    "tests/modal_id/posterior/test_likelihood.py",
    "tests/modal_id/solve",
    "tests/tracker/register/test_kernel.py",
)
# Largest difference between processors, in the unit of `numerical_values`, as docs/files.md states it.
TOLERANCE = {
    "beam: relative frequency": 1e-12,
    "beam bent by its weight: relative frequency": 1e-9,
    "beam: shape over its largest value": 1e-7,
    "simulation: displacement over the largest": 1e-7,
    "fit: frequency and damping in standard deviations": 1e-4,
    "posterior: mean and standard deviation, in standard deviations": 1e-3,
    "registration: px": 1e-5,
}


def environments():
    """Name and variables of each environment; those that this processor cannot run are None."""
    found = {"this processor": {}}
    for kernel, needed in BLAS_KERNELS.items():
        found[kernel] = {"OPENBLAS_CORETYPE": kernel} if __cpu_features__.get(needed) else None
    found["generic"] = {"NUMBA_CPU_NAME": "generic"}
    return found


def run(name, variables, folder):
    """Output of the tests, or None where they pass, and the values."""
    environment = os.environ | variables | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    if "NUMBA_CPU_NAME" in variables:
        environment["NUMBA_CACHE_DIR"] = str(folder / "numba")
    values = folder / f"{name}.json"
    command = [sys.executable, "-m", "support.numerical_values", str(values)]
    done = subprocess.run(command, check=False, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode == 0 and variables:
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", *TESTS]
        done = subprocess.run(command, check=False, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode:
        return done.stdout + done.stderr, None
    return None, json.loads(values.read_text())


def differences(values, here):
    """Largest difference of each group."""
    return {group: float(np.max(np.abs(np.subtract(values[group], here[group])))) for group in TOLERANCE}


def main():
    """Run all environments, two at a time, and print the differences; exit status 1 where one fails."""
    everyone = environments()
    able = {name: variables for name, variables in everyone.items() if variables is not None}
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(2) as pool:
        # the longest first
        order = sorted(able, key=lambda x: x != "generic")
        results = dict(zip(order, pool.map(lambda x: run(x, able[x], Path(name)), order), strict=True))
    failed = [name for name, (output, _) in results.items() if output]
    for name in failed:
        sys.stderr.write(f"{name}: the tests failed\n{results[name][0]}\n")
    if "this processor" in failed:
        return 1
    rows = {
        name: differences(values, results["this processor"][1])
        for name, (output, values) in results.items()
        if not output and name != "this processor"
    }
    sys.stdout.write(
        "largest difference from this processor" + "".join(f"{n:>12}" for n in rows) + "   allowed\n"
    )
    for group, allowed in TOLERANCE.items():
        found = [row[group] for row in rows.values()]
        sys.stdout.write(f"{group:64}" + "".join(f"{x:>12.1e}" for x in found) + f"{allowed:>10.0e}\n")
        if not all(x <= allowed for x in found):
            failed.append(group)
    for name in everyone.keys() - able.keys():
        sys.stdout.write(f"{name}: this processor lacks {BLAS_KERNELS[name]}\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
