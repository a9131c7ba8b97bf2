import numpy as np
import pytest

from docs.reference_solutions import elastica_tip
from sim import paper_beam
from sim.beam import (
    BAND,
    PAD,
    AncfBeam,
    NoEquilibriumError,
    add_product,
    diagonals,
    factor_symmetric,
    from_band,
    lower_columns,
    solve_symmetric,
    static_equilibrium,
)

EI = 210e9 * 5e-3 * 0.5e-3**3 / 12.0
L = 0.5


def random_state(beam, size=1e-2, seed=0):
    return np.random.default_rng(seed).normal(size=beam.ndof) * size / beam.dof_scale


@pytest.mark.parametrize("gauss_points", [3, 5])
def test_force_and_tangent_are_derivatives_of_the_energy(gauss_points):
    beam = AncfBeam(paper_beam(), gauss_points)
    q = random_state(beam)
    direction = random_state(beam, size=1.0, seed=1)
    state = beam.elastic(q)
    step = 1e-6
    up, down = beam.elastic(q + step * direction), beam.elastic(q - step * direction)
    # central differences: relative error of about step^2 times the cubic terms
    assert (up.energy_j - down.energy_j) / (2 * step) == pytest.approx(state.force_n @ direction, rel=1e-6)
    np.testing.assert_allclose(
        (up.force_n - down.force_n) / (2 * step),
        from_band(state.tangent) @ direction,
        rtol=1e-6,
        atol=1e-6 * np.abs(from_band(state.tangent) @ direction).max(),
    )


def test_rigid_rotation_stores_no_energy():
    beam = AncfBeam(paper_beam("none"))
    # the clamp fixes the first node, so only the elements next to it are bent and are excluded
    angle = 1.0
    s = np.arange(1, 21) * L / 20
    q = np.empty(80)
    q[0::4], q[1::4] = s * (np.cos(angle) - 1.0), s * np.sin(angle)
    q[2::4], q[3::4] = np.cos(angle) - 1.0, np.sin(angle)
    forces = beam.elastic(q).force_n
    stiff = 210e9 * 2.5e-6
    assert np.abs(forces[8:]).max() < 1e-12 * stiff


ELASTICA = [(1, 0.30172, 0.05643), (2, 0.49346, 0.16064), (5, 0.71379, 0.38763), (10, 0.81061, 0.55500)]


@pytest.mark.parametrize(("load", "w", "u"), ELASTICA)
@pytest.mark.parametrize("elements", [20, 40])
def test_elastica_under_a_tip_load(load, w, u, elements):
    exact = elastica_tip(load)
    np.testing.assert_allclose(exact, [w, u], atol=6e-6, err_msg="published tables have five decimals")
    beam = AncfBeam(paper_beam("none", elements))
    force = np.zeros(beam.ndof)
    force[-3] = load * EI / L**2
    q = static_equilibrium(beam, force)
    tolerance = {20: 5e-4, 40: 5e-5}[elements]
    np.testing.assert_allclose([q[-3] / L, -q[-4] / L], exact, rtol=tolerance)


@pytest.mark.parametrize(("elements", "tolerance"), [(20, 1e-4), (40, 5e-6)])
def test_roll_up_to_a_full_circle(elements, tolerance):
    beam = AncfBeam(paper_beam("none", elements))
    q = static_equilibrium(beam, tip_moment_n_m=2.0 * np.pi * EI / L)
    assert np.hypot(q[-4] + L, q[-3]) < tolerance * L


def test_statics_without_convergence_is_a_failure():
    beam = AncfBeam(paper_beam("hanging"))
    load = np.zeros(beam.ndof)
    # straight, axial compression by many times the buckling load
    load[-4] = -50.0 * EI / L**2
    with pytest.raises(NoEquilibriumError, match="unstable"):
        static_equilibrium(beam, load)


def test_a_load_of_the_wrong_size_is_refused():
    with pytest.raises(ValueError, match=r"load must have shape \(80,\)"):
        static_equilibrium(AncfBeam(paper_beam()), np.zeros(84))


@pytest.mark.parametrize("decoupled", [False, True])
def test_band_kernels_agree_with_dense_algebra(decoupled):
    rng = np.random.default_rng(3)
    n = 40
    dense = np.zeros((n, n))
    for k in range(-PAD, PAD + 1, 1):
        if k % 2 == 0 or not decoupled:
            dense += np.diag(rng.normal(size=n - abs(k)), k)
    dense = dense + dense.T + 20.0 * np.eye(n)
    band = np.zeros((n, BAND))
    for i in range(n):
        for j in range(max(0, i - PAD), min(n, i + PAD + 1)):
            band[i, j - i + PAD] = dense[i, j]
    b = rng.normal(size=n)
    product = np.ones(n)
    add_product(diagonals(band, decoupled=decoupled), np.pad(b, PAD), product)
    np.testing.assert_allclose(product, 1.0 + dense @ b, atol=1e-12)
    columns, inverse_pivot = lower_columns(band), np.empty(n)
    assert factor_symmetric(columns, inverse_pivot)
    x = np.concatenate([b, np.zeros(PAD)])
    solve_symmetric(columns, inverse_pivot, x)
    np.testing.assert_allclose(dense @ x[:n], b, atol=1e-10)
    assert not factor_symmetric(np.zeros_like(columns), inverse_pivot)
