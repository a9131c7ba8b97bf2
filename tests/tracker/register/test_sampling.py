"""Registration gives the same bytes with newly compiled kernels and with cached ones."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from support.paths import ROOT

_REGISTER = """
import sys
import numpy as np
from tracker.register.marker import Camera, register
from tracker.template.noise import NoiseModel
from tracker.template.template import disc_template

template, rng = disc_template(8.0, 0.9), np.random.default_rng(3)
camera = Camera(NoiseModel(2.0, 0.05), 255.0)
rows, columns = np.mgrid[:40, :40]
for x, y in 20.0 + rng.uniform(-1.0, 1.0, (50, 2)):
    disc = 160.0 - 100.0 / (1.0 + np.exp((np.hypot(columns - x, rows - y) - 8.0) / 0.6))
    image = np.clip(rng.normal(disc, 3.0), 0.0, 255.0).astype(np.uint8)
    start = np.array([20.0, 20.0, 0.0, -100.0, 160.0])
    result = register(image, start, np.eye(2), template, camera, with_angle=True, max_shift_px=4.0)
    sys.stdout.write(result.tobytes().hex())
"""


@pytest.mark.slow  # in the fast suite: two processes, one of which compiles (modalcam/pipeline/test_compile)
def test_new_and_cached_kernels_give_the_same_bytes(tmp_path) -> None:
    """The first run compiles and stores the kernels, the second loads them."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", _REGISTER], env=environment, check=True, capture_output=True, text=True
        ).stdout
        for _ in range(2)
    )
    assert list(tmp_path.rglob("*.nbc")), "the first run stored no compiled kernel"
    assert len(first) > 50 * 100, "no results were written"
    assert first == second, "the cached kernels round differently from the newly compiled ones"
