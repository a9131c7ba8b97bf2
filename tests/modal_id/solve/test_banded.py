"""Banded matrices of the baseline, against dense ones; memory over the length of a record."""

import numpy as np
import pytest
from kit.identified import quick
from kit.series import series_of
from scipy.sparse import csr_array
from support.memory import peak_of

from modal_id import Identification
from modal_id.solve import BandedFactor, normal_band


@pytest.mark.parametrize("reach", [1, 3])
def test_solutions_are_those_of_the_dense_matrix(reach):
    rng = np.random.default_rng(reach)
    columns = np.zeros((60, 20))
    for row in range(60):
        first = row * (20 - reach) // 60
        columns[row, first : first + reach + 1] = rng.normal(size=reach + 1)
    weights = rng.uniform(0.2, 1.0, 60)
    dense = columns.T @ (weights[:, None] * columns) + 0.1 * np.eye(20)
    band = normal_band(csr_array(columns), weights)
    assert band.shape == (reach + 1, 20)
    band[0] += 0.1
    factor, right = BandedFactor.of(band), rng.normal(size=(20, 3))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(dense, right), rtol=1e-9)
    np.testing.assert_allclose(
        factor.solve(right + 1j * right[::-1]), np.linalg.solve(dense, right + 1j * right[::-1]), rtol=1e-9
    )
    whitened = np.linalg.solve(np.linalg.cholesky(dense), right)
    np.testing.assert_allclose(factor.whiten(right), whitened, rtol=1e-9, atol=1e-12)


def memory_of(samples):
    """Peak memory in bytes of the identification of a decay of 1 Hz over the whole record, ten samples a cycle."""
    time_s = 0.1 * np.arange(samples)
    motion = np.exp(-3.0 * time_s / time_s[-1]) * np.cos(2.0 * np.pi * time_s)
    motion += 0.01 * np.random.default_rng(1).standard_normal(samples)
    series = series_of(time_s, motion[:, None])
    return peak_of(lambda: quick(series, max_modes=1))


def test_memory_is_linear_in_the_length_of_the_record():
    """750 cycles have 600 splines: each of their matrices would take 3 MB if it were dense."""
    memory_of(500)
    short, _ = memory_of(1500)
    long, found = memory_of(7500)
    assert isinstance(found, Identification)
    assert found.modes[0].frequency_hz == pytest.approx(1.0, abs=5.0 * found.modes[0].frequency_sd_hz)
    assert long < 6.0 * short, (
        f"{long / 1e6:.1f} MB for 7500 samples and {short / 1e6:.1f} MB for 1500: expected five times as much, and a "
        "fifth more for blocks of fixed size"
    )
