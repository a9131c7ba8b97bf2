"""Small dense systems give the bytes of NumPy and SciPy."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from modal_id.solve import cholesky, pseudo_inverse, solve


@pytest.mark.parametrize("size", [1, 2, 4, 10, 40])
@pytest.mark.parametrize("rank_lost", [0, 1])
def test_the_pseudo_inverse_has_the_bytes_of_numpy(size, rank_lost):
    """Also of singular matrices, and of a matrix with a negative eigenvalue."""
    root = np.random.default_rng(size).standard_normal((size, size - rank_lost + (size == 1)))
    for matrix in (root @ root.T, root @ root.T - 0.5 * np.eye(size)):
        assert pseudo_inverse(matrix).tobytes() == np.linalg.pinv(matrix, hermitian=True).tobytes()


def test_a_system_is_solved_with_the_bytes_of_scipy():
    rng = np.random.default_rng(1)
    root, right = rng.standard_normal((6, 9)), rng.standard_normal((6, 3))
    matrix = root @ root.T
    expected = cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False)
    assert solve(cholesky(matrix), right).tobytes() == expected.tobytes()
    assert solve(cholesky(matrix), right[:, :0]).shape == (6, 0)


def test_a_matrix_that_is_not_positive_definite_is_refused():
    with pytest.raises(LinAlgError, match="2 rows is not positive definite"):
        cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]))
