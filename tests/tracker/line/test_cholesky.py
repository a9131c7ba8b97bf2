"""Small positive definite systems against `numpy.linalg.solve`, singular ones, few stations, empty profiles."""

import numpy as np
import pytest

from tracker.line import Light, ProfileSums, kernel, known_light_shift, light_basis, solve_in_place

EPS = np.finfo(np.float64).eps


def solved(matrix, rhs):
    out = np.full(rhs.size, np.nan)
    return solve_in_place(matrix.copy(), rhs, out), out


def positive_definite(rng, size, condition):
    turn = np.linalg.qr(rng.standard_normal((size, size)))[0]
    return (turn * np.geomspace(1.0, 1.0 / condition, size)) @ turn.T


@pytest.mark.parametrize("condition", [1.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("size", [1, 3, 6, 14])
def test_solutions_are_those_of_numpy(size, condition):
    rng = np.random.default_rng(size)
    for _ in range(20):
        matrix = positive_definite(rng, size, condition)
        true = rng.standard_normal(size)
        rhs = matrix @ true
        regular, found = solved(matrix, rhs)
        assert regular, f"a matrix with condition number {condition:g} is regular"
        # Higham (2002), theorem 10.4: each solution is off by at most 8 n^2 eps times condition number and norm.
        bound = 2.0 * 8.0 * size**2 * EPS * condition * np.linalg.norm(true)
        off = np.linalg.norm(found - np.linalg.solve(matrix, rhs))
        assert off <= bound, f"off by {off:.2g}, bound {bound:.2g} for both solutions together"


@pytest.mark.parametrize("stations", [0, 1, 2, 3, 4])
def test_light_needs_as_many_stations_as_its_polynomial_has_terms(stations):
    """With fewer the normal matrix has a rank below its size, which `numpy.linalg.matrix_rank` tells independently."""
    rng = np.random.default_rng(stations)
    basis = light_basis(12)
    used = np.zeros(12, dtype=bool)
    used[rng.choice(12, stations, replace=False)] = True
    normal = basis[used].T @ basis[used]
    regular = np.linalg.matrix_rank(normal, hermitian=True) == 3
    assert regular == (stations >= 3), "the matrices of this test are those of its name"
    assert solved(normal, np.ones(3))[0] == regular
    results, out = np.zeros((12, kernel.RESULT)), np.full(12, np.nan)
    results[:, kernel.GAIN : kernel.OFFSET + 1] = rng.standard_normal((12, 2))
    results[:, kernel.BY_GAIN : kernel.BY_GAIN + 2] = 1.0
    light = Light(np.zeros((12, 2)), basis, 1.0, 1.0)
    if not regular:
        with pytest.raises(np.linalg.LinAlgError, match="expected at least 3 stations"):
            known_light_shift(light, results, used, out)
        return
    known_light_shift(light, results, used, out)
    values = results[used, kernel.GAIN : kernel.OFFSET + 1]
    smooth = basis[used] @ np.linalg.lstsq(basis[used], values, rcond=None)[0]
    # twelve products of a condition number below 1e3, squared in the normal matrix
    np.testing.assert_allclose(out[used], np.sum(values - smooth, axis=1), atol=12 * EPS * 1e6)
    assert not np.any(out[~used])


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_a_singular_matrix_is_reported_and_its_solution_is_finite(rank):
    """As that of a line whose missing stations leave splines without a value; `numpy.linalg.solve` raises for zeros."""
    rows = np.random.default_rng(rank).standard_normal((rank, 3))
    regular, found = solved(rows.T @ rows, np.zeros(3))
    assert not regular
    assert np.all(np.isfinite(found))
    if rank == 0:
        with pytest.raises(np.linalg.LinAlgError):
            np.linalg.solve(rows.T @ rows, np.zeros(3))


def test_nan_is_kept_as_numpy_does():
    matrix = np.eye(3)
    matrix[1, 1] = np.nan
    regular, found = solved(matrix, np.ones(3))
    assert regular
    assert np.isnan(found[1])
    assert np.isnan(np.linalg.solve(matrix, np.ones(3))[1])


@pytest.mark.parametrize("reach_px", [1.0, 3.0, 20.0])
def test_without_pixels_the_profile_is_zero(reach_px):
    """The smoothing alone leaves every parabola free: its matrix has no factor but for rounding."""
    assert not np.any(ProfileSums(reach_px, 2).solve().coefs)
