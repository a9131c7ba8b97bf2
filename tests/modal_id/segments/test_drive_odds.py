"""The probability of a drive, compared with Bayes' theorem by quadrature."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import cauchy, norm

from modal_id.segments import drive_probability, may_be_driven

# Widths and limits that the description of the function states.
DRIVE_CHANGES, LEAST, MOST = np.array([0.0005, 0.005]), 1e-5, 0.5


def by_quadrature(change, sd, radians, prior):
    """Both likelihoods as integrals over the true change and over ln zeta."""
    near = [change - 8 * sd, change, change + 8 * sd, 0.0]
    driven = quad(
        lambda true: norm.pdf(change, true, sd) * np.mean(cauchy.pdf(true, 0.0, DRIVE_CHANGES)),
        min(near),
        max(near),
        points=sorted(near)[1:-1],
        limit=200,
    )[0]
    log_zeta = np.linspace(np.log(LEAST), np.log(MOST), 200_001)
    density = norm.pdf(change, np.exp(log_zeta) * radians, sd)
    free = np.trapezoid(density, log_zeta) / np.log(MOST / LEAST)
    return prior * driven / (prior * driven + (1.0 - prior) * free)


@pytest.mark.parametrize("change", [-0.05, 0.0, 0.01, 0.03, 0.3])
@pytest.mark.parametrize(
    ("sd", "radians", "prior"), [(0.003, 60.0, 0.5), (0.02, 400.0, 0.02), (0.08, 60.0, 0.8)]
)
def test_it_is_bayes_theorem(change, sd, radians, prior):
    expected = by_quadrature(change, sd, radians, prior)
    # cells of ln zeta of 3 % hold a narrow density to 1 %
    assert drive_probability(change, sd, radians, prior) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("change", [0.0, 0.06, 0.3])
@pytest.mark.parametrize("follows", [3e-4, 3e-3, 0.05, 0.3])
def test_what_follows_a_change_is_evidence_too(change, follows):
    """Both hypotheses with the damping ratio after the change, by a sum over 200 001 values of ln zeta."""
    sd, radians = 0.01, 100.0
    log_zeta = np.linspace(np.log(LEAST), np.log(MOST), 200_001)
    driven = quad(
        lambda true: norm.pdf(change, true, sd) * np.mean(cauchy.pdf(true, 0.0, DRIVE_CHANGES)),
        min(change, 0.0) - 8 * sd,
        max(change, 0.0) + 8 * sd,
        points=[0.0, change],
        limit=200,
    )[0]
    least = np.maximum(1.5 * np.exp(log_zeta), 0.01)
    held = np.where((follows > least) & (follows < 0.7), 1.0 / np.log(0.7 / np.minimum(least, 0.69)), 0.0)
    log_range = np.log(MOST / LEAST)
    after = 0.4 * norm.pdf(np.log(follows), log_zeta, 0.3) + 0.4 * held + 0.2 / log_range
    free = np.trapezoid(norm.pdf(change, np.exp(log_zeta) * radians, sd) * after, log_zeta)
    # prior 0.5; the logarithm of the range of zeta is in both
    expected = driven / (driven + free)
    assert drive_probability(change, sd, radians, follows=follows) == pytest.approx(expected, abs=0.01)


def test_a_steady_motion_before_a_light_decay_is_a_drive_and_before_a_hand_may_be_free():
    """The decay's damping ratio, 0.3 %, would have shown before it; a hand's, 5 %, says nothing.

    Alone, five cycles without a change are no more than weak evidence of a drive.
    """
    assert drive_probability(0.001, 0.001, 22.0, follows=0.003) > 2.0 / 3.0
    assert drive_probability(0.001, 0.001, 22.0) < 2.0 / 3.0
    assert may_be_driven(drive_probability(0.065, 0.02, 180.0, follows=0.05))
    assert drive_probability(0.065, 0.02, 180.0, follows=0.05) < 0.5


def test_what_is_lost_precisely_is_a_decay_and_what_is_kept_a_drive():
    assert not may_be_driven(drive_probability(0.4, 0.002, 60.0))
    assert drive_probability(0.0, 0.002, 560.0) > 0.95, "the least damping of a structure would show 3 sd"
    undecided = drive_probability(0.0, 0.05, 60.0)
    assert may_be_driven(undecided)
    assert undecided < 0.95


@given(st.floats(-0.5, 1.0), st.floats(1e-4, 0.09), st.floats(1.0, 1e4))
def test_a_growing_motion_is_no_more_free_than_a_decaying_one(change, sd, radians):
    grown, lost = (drive_probability(sign * abs(change), sd, radians) for sign in (-1.0, 1.0))
    assert 0.0 <= lost <= grown + 1e-12 <= 1.0 + 1e-11


@pytest.mark.parametrize("values", [(0.0, 0.2, 60.0), (float("nan"), 0.01, 60.0), (0.0, float("inf"), 60.0)])
def test_a_change_that_is_hardly_known_decides_nothing(values):
    assert drive_probability(*values, prior=0.8) == 0.5


def test_a_change_that_is_hardly_known_may_tell_of_a_decay():
    """Thirteen standard deviations are a decay, whatever the standard deviation; the prior of a release is kept."""
    assert drive_probability(2.0, 0.15, 200.0, prior=0.5) < 0.05
    known, hardly = (drive_probability(0.2, sd, 200.0, prior=0.1) for sd in (0.0999, 0.1001))
    assert hardly == pytest.approx(known, rel=0.01), "no step at the limit"
