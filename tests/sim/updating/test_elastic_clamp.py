"""An unknown elastic clamp: exact sensitivities, and the truth within the intervals of its stiffnesses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from support.beams import assert_exact_sensitivities

from sim import paper_beam
from sim.beam import AncfBeam, ElasticClamp, beam_modes
from sim.updating import (
    BeamFamily,
    MeasuredModes,
    SmoothPrior,
    UndecidedError,
    UpdatingSettings,
    find_clamp,
    update_by,
)

SD = 1e-4
# one factor each on width, thickness, density and modulus, with a standard deviation of 5 %
UNIFORM = SmoothPrior(0.05, np.inf)
ELEMENTS = 8


@pytest.mark.parametrize("orientation", ["hanging", "horizontal"])
def test_stiffnesses_have_exact_sensitivities(orientation):
    beam = replace(paper_beam(orientation, ELEMENTS), clamp=ElasticClamp(0.8, 900.0))
    family = BeamFamily(beam, 4, clamp=True)
    u = np.zeros(family.variables)
    u[-2:] = [0.3, -0.4]
    scaled = family.properties(u)
    assert scaled.clamp.translation_n_m == pytest.approx(np.exp(0.3) * 900.0)
    assert scaled.clamp.rotation_n_m_rad == pytest.approx(np.exp(-0.4) * 0.8)
    assert_exact_sensitivities(family, u)


def measured_with(clamp, seed):
    """Frequencies of a beam drawn from the prior, with this clamp and errors of the usual size."""
    rng, basis = np.random.default_rng(seed), UNIFORM.basis(ELEMENTS)
    drawn = BeamFamily(paper_beam("hanging", ELEMENTS), 1).properties(
        basis @ rng.standard_normal(basis.shape[1])
    )
    exact = beam_modes(AncfBeam(replace(drawn, clamp=clamp)), 5).frequency_hz
    seen = exact * (1.0 + SD * rng.standard_normal(5))
    return MeasuredModes(np.arange(1, 6), seen, np.zeros(5), model_sd=SD)


def inside(seed):
    """Whether stiffnesses drawn from the prior are in their 90 % intervals."""
    rng, beam = np.random.default_rng([seed, 1]), paper_beam("hanging", ELEMENTS)
    rigid = find_clamp(beam, measured_with(None, seed), prior=UNIFORM)
    truth = rigid.prior_median * np.exp(rigid.prior_log_sd * rng.standard_normal(2))
    clamp = ElasticClamp(float(truth[1]), float(truth[0]))
    low, high = find_clamp(beam, measured_with(clamp, seed), prior=UNIFORM, seed=seed).interval().T
    return (low <= truth) & (truth <= high)


def test_a_soft_clamp_is_found_and_a_rigid_one_is_preferred_where_it_is():
    beam, clamp = paper_beam("hanging", ELEMENTS), ElasticClamp(1.0, 300.0)
    found = find_clamp(beam, measured_with(clamp, 1), prior=UNIFORM)
    (least, most), (least_turn, most_turn) = found.interval()
    assert least < 300.0 < most < 2.0 * least, (
        "mode 5 is lowered by a quarter, known to the error of the modulus"
    )
    assert least_turn < 1.0 < most_turn
    assert found.log_odds > 10.0
    rigid = find_clamp(beam, measured_with(None, 1), prior=UNIFORM)
    assert np.isinf(rigid.interval()[:, 1]).all()
    assert rigid.log_odds < 0.0
    assert rigid.interval()[0, 0] > 1e3, "it would lower mode 5 by a tenth, modes 1 to 4 by less"


@pytest.mark.slow
def test_intervals_contain_the_truth():
    hits = np.sum([inside(seed) for seed in range(40)], axis=0)
    # one-sided where a side is open, and then wider than 90 % for stiffnesses beyond the other one
    assert np.all(hits >= binom.ppf(1e-3, 40, 0.9)), f"{hits} of 40 in 90 % intervals"


def test_a_clamp_is_looked_for_where_it_is_asked_for_and_there_is_one():
    beam = paper_beam("hanging", ELEMENTS)
    found = update_by("clamp", beam, measured_with(None, 2), UpdatingSettings(clamp=True))
    assert found.effective_draws > 100
    pinned = replace(beam, ends=("pinned", "pinned"))
    with pytest.raises(UndecidedError, match="needs a clamped first end; it is pinned"):
        find_clamp(pinned, measured_with(None, 2))
