"""Derivatives of frequencies and shapes with respect to each variable, compared with complex steps and differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eig

from sim import paper_beam, sample_beam
from sim.beam import AncfBeam, ElasticClamp, beam_modes
from sim.updating import BeamFamily, BeamMatrices, MeasuredShape

# one of each kind of variable, at the clamp, inside and at the tip
CHOSEN = (0, 3, 7, 8, 12, 15, 16, 17)
BEAMS = {
    "hanging": paper_beam(elements=8),
    "weightless": paper_beam("none", elements=8),
    "standing": paper_beam("standing", elements=8),
    "sagging": replace(paper_beam("horizontal", elements=8), length_m=0.3),
    "point mass": sample_beam(8),
    "rotational clamp": replace(sample_beam(8), clamp=ElasticClamp(0.5)),
    "elastic clamp": replace(sample_beam(8), clamp=ElasticClamp(0.5, 1e5)),
    "held at both ends": replace(
        paper_beam("horizontal", elements=8), length_m=0.3, ends=("pinned", "guided"), tension_n=2.0
    ),
    "free": replace(sample_beam(8), ends=("guided", "free")),
}


def points_of(number, positions_m):
    """Points at which a shape is evaluated, with arbitrary measured values."""
    return MeasuredShape(number, np.array(positions_m), np.ones(len(positions_m)), np.ones(len(positions_m)))


def some_factors(rows=1):
    return np.random.default_rng(1).normal(0.0, 0.05, (rows, 18))


@pytest.mark.parametrize("name", BEAMS)
def test_batch_modes_match_those_of_each_beam(name):
    family = BeamFamily(BEAMS[name], 5, (points_of(3, [0.1, 0.25]),))
    factors = some_factors(2)
    found = family.modes(factors)
    for i, one in enumerate(factors):
        modes = beam_modes(AncfBeam(family.properties(one)), 5)
        # both equilibria are accurate to 1e-12 of the length, which weight turns into strain where it bends the beam
        np.testing.assert_allclose(found.frequency_hz[i], modes.frequency_hz, rtol=1e-9)
        shape = modes.transverse_at(np.array([0.1, 0.25]))[:, 2]
        np.testing.assert_allclose(np.abs(found.shapes[0][i]), np.abs(shape), rtol=1e-5)


@pytest.mark.parametrize("name", BEAMS)
def test_frequency_derivatives_match_complex_steps(name):
    """A complex step has no cancellation error; only the rounding error of the eigensolver remains."""
    family = BeamFamily(BEAMS[name], 5)
    base = some_factors()
    slopes = family.modes(base, slopes=True).log_frequency_slopes[0]
    frequency_hz = family.modes(base).frequency_hz[0]
    step = 1e-20
    for j in CHOSEN:
        moved = base.astype(complex)
        moved[0, j] += 1j * step
        state = BeamMatrices(BEAMS[name]).state(moved)
        stiffness, mass = state.modal_k[0], state.modal_m[0]
        exact = derivatives_of_squares(stiffness, mass, step, frequency_hz)
        np.testing.assert_allclose(slopes[:, j], 0.5 * exact, atol=1e-6)


def derivatives_of_squares(stiffness, mass, step, frequency_hz):
    """``y (dK - lambda dM) x / (lambda y M x)`` with left and right eigenvectors of a general solver."""
    values, left, right = eig(stiffness.real, mass.real, left=True)
    out = []
    for frequency in frequency_hz:
        square = (2.0 * np.pi * frequency) ** 2
        r = int(np.argmin(np.abs(values - square)))
        y, x = left[:, r].conj(), right[:, r]
        change = y @ (stiffness.imag - square * mass.imag) @ x / step
        out.append((change / (square * (y @ mass.real @ x))).real)
    return np.array(out)


@pytest.mark.parametrize("name", BEAMS)
def test_derivatives_are_limits_of_central_differences(name):
    """Central differences converge to the derivatives with the square of the step."""
    points = tuple(points_of(number, [0.08, 0.15, 0.29]) for number in (1, 3))
    family = BeamFamily(BEAMS[name], 5, points)
    base = some_factors()
    at = family.modes(base, slopes=True)
    direction = np.random.default_rng(2).normal(size=18)
    errors = []
    for step in (1.6e-2, 8e-3):
        ends = family.modes(np.concatenate([base + step * direction, base - step * direction]))
        parts = [np.log(ends.frequency_hz[0] / ends.frequency_hz[1]) / (2.0 * step)]
        exact = [at.log_frequency_slopes[0] @ direction]
        for values, slopes, end in zip(at.shapes, at.shape_slopes, ends.shapes, strict=True):
            aligned = end * np.sign(end @ values[0])[:, np.newaxis]
            parts.append((aligned[0] - aligned[1]) / (2.0 * step))
            exact.append(slopes[0] @ direction)
        errors.append(np.linalg.norm(np.concatenate(parts) - np.concatenate(exact)))
    assert errors[1] < 5e-3 * np.linalg.norm(np.concatenate(exact))
    order = np.log2(errors[0] / errors[1])
    assert 1.9 < order < 2.1, f"central differences are of order 2; observed {order:.3f}, errors {errors}"


def test_derivatives_include_gravity_stiffness():
    """Weight stiffens a hanging beam: density lowers mode 1 less than the exponent -1/2 of a weightless beam."""
    hanging, weightless = (
        BeamFamily(paper_beam(o, elements=8), 2)
        .modes(np.zeros(18), slopes=True)
        .log_frequency_slopes[0, :, -2]
        for o in ("hanging", "none")
    )
    np.testing.assert_allclose(weightless, -0.5, rtol=1e-9)
    # f^2 = a E h^2 / rho + b g: the fraction of mode 1 due to weight is 1 - (1.6553 / 1.8761)^2
    assert hanging[0] == pytest.approx(-0.5 * (1.6553 / 1.8761) ** 2, rel=2e-3)


def test_buckled_beam_has_no_modes():
    family = BeamFamily(paper_beam("standing", elements=8), 3)
    thinner = np.zeros((2, 18))
    # Greenhill: half the thickness has an eighth of the buckling load at half the weight
    thinner[1, 8:16] = np.log(0.5)
    found = family.modes(thinner, slopes=True)
    assert np.all(np.isfinite(found.frequency_hz[0]))
    assert np.isnan(found.frequency_hz[1, 0])
