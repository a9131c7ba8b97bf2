"""The probability of a drive, compared with Bayes' theorem by quadrature."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import cauchy, norm

from modal_id.segments import is_driven_part, may_be_driven, roles_of

# Widths, limits and other constants that the description of the function states.
DRIVE_CHANGES, LOG_ZETA = np.array([0.0005, 0.005]), np.linspace(np.log(1e-5), np.log(0.5), 200_001)
LOG_RANGE = LOG_ZETA[-1] - LOG_ZETA[0]
# Shares of free motions and of drives that grow, by a half-normal amount with this standard deviation.
GROWS, DRIVE_GROWS, GROWTH_SD = 0.02, 0.2, 0.3


def drive_probability(*motion, prior=0.5):
    return roles_of(*motion, prior).driven


def densities(change, sd, radians, after=1.0):
    """Of the change for a drive and for a decay, as integrals over the true change and over ln zeta."""
    near = sorted([change - 8 * sd, change, change + 8 * sd, 0.0])

    def product(true):
        return norm.pdf(change, true, sd) * np.mean(cauchy.pdf(true, 0.0, DRIVE_CHANGES))

    driven = quad(product, near[0], near[-1], points=near[1:-1], limit=200)[0]
    free = np.trapezoid(norm.pdf(change, np.exp(LOG_ZETA) * radians, sd) * after, LOG_ZETA) / LOG_RANGE
    grown = np.linspace(-3.0, 0.0, 200_001)
    grows = np.trapezoid(norm.pdf(change, grown, sd) * 2.0 * norm.pdf(grown, 0.0, GROWTH_SD), grown)
    # what follows a motion that grows is any motion
    grows *= 1.0 if np.ndim(after) == 0 else 1.0 / LOG_RANGE
    driven *= 1.0 if np.ndim(after) == 0 else 1.0 / LOG_RANGE
    return (1.0 - DRIVE_GROWS) * driven + DRIVE_GROWS * grows, (1.0 - GROWS) * free + GROWS * grows


@pytest.mark.parametrize("change", [-0.05, 0.0, 0.01, 0.03, 0.3])
@pytest.mark.parametrize(("sd", "radians", "prior"), [(0.003, 60, 0.5), (0.02, 400, 0.02), (0.08, 60, 0.8)])
def test_it_is_bayes_theorem(change, sd, radians, prior):
    driven, free = densities(change, sd, radians)
    expected = prior * driven / (prior * driven + (1.0 - prior) * free)
    # cells of ln zeta of 3 % hold a narrow density to 1 %
    assert drive_probability(change, sd, radians, prior=prior) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("change", [0.0, 0.06, 0.3])
@pytest.mark.parametrize("follows", [3e-4, 3e-3, 0.05, 0.3])
def test_what_follows_a_change_is_evidence_too(change, follows):
    """Both hypotheses with the damping ratio after the change; the prior is 0.5."""
    least = np.maximum(1.5 * np.exp(LOG_ZETA), 0.01)
    held = np.where((follows > least) & (follows < 0.7), 1.0 / np.log(0.7 / np.minimum(least, 0.69)), 0.0)
    sd = 0.1 * follows
    after = (
        0.9 * (0.9 * norm.pdf(np.log(follows), LOG_ZETA, np.hypot(0.3, 0.1)) + 0.1 * held) + 0.1 / LOG_RANGE
    )
    driven, free = densities(change, 0.01, 100.0, after)
    expected = driven / (driven + free)
    assert roles_of(change, 0.01, 100.0, after=(follows, sd)).driven == pytest.approx(expected, abs=0.01)


def test_a_steady_motion_before_a_light_decay_is_a_drive_and_before_a_hand_may_be_free():
    """The decay's damping ratio, 0.3 %, would have shown before it; a hand's, 5 %, says nothing.

    Alone, the part is not called driven: that takes odds of two to one.
    """
    assert is_driven_part(roles_of(0.001, 0.001, 22.0, after=(0.003, 1e-4)).driven)
    assert not is_driven_part(drive_probability(0.001, 0.001, 22.0))
    assert 0.05 < roles_of(0.065, 0.02, 180.0, after=(0.05, 1e-3)).driven < 0.5


def test_what_is_lost_precisely_is_a_decay_and_what_is_kept_a_drive():
    assert not may_be_driven(drive_probability(0.4, 0.002, 60.0))
    assert drive_probability(0.0, 0.002, 560.0) > 0.95, "the least damping of a structure would show 3 sd"
    assert 0.05 < drive_probability(0.0, 0.05, 60.0) < 0.95


@given(st.floats(-0.5, 1.0), st.floats(1e-4, 0.09), st.floats(1.0, 1e4))
def test_a_growing_motion_is_no_more_free_than_a_decaying_one(change, sd, radians):
    assume(2e-5 * radians < abs(change) < 0.4 * radians)  # the damping ratio of a structure
    grown, lost = (drive_probability(sign * abs(change), sd, radians) for sign in (-1.0, 1.0))
    assert 0.0 <= lost <= grown + 1e-12 <= 1.0 + 1e-11


def test_a_motion_that_doubles_is_neither_a_steady_drive_nor_a_decay():
    """Half of the beat of two modes, or a drive that is tuned: the odds are those of growth, 0.2 to 0.02."""
    assert drive_probability(-0.7, 0.05, 23.0) == pytest.approx(0.2 / 0.22, abs=0.01)


@pytest.mark.parametrize("values", [(0.0, 0.2, 60.0), (float("nan"), 0.01, 60.0), (0.0, float("inf"), 60.0)])
def test_a_change_that_is_hardly_known_decides_nothing(values):
    assert drive_probability(*values, prior=0.8) <= 0.8


def test_a_change_that_is_hardly_known_may_tell_of_a_decay():
    """Thirteen standard deviations are a decay, whatever the standard deviation; the prior of a release is kept."""
    assert drive_probability(2.0, 0.15, 200.0, prior=0.5) < 0.05
    known, hardly = (drive_probability(0.2, sd, 200.0, prior=0.1) for sd in (0.0999, 0.1001))
    assert hardly == pytest.approx(known, rel=0.01), "no step at the limit"
