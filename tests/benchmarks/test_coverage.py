"""The coverage study on a few decays of each case: intervals of frequency and damping ratio hold the truth."""

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.coverage import covered, run_trial
from benchmarks.coverage_cases import CASES

LEVELS = (0.5, 0.9, 0.99)


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("case", "seeds"),
    [
        ("all together", range(500, 502)),
        *(pytest.param(case, range(500, 504), marks=pytest.mark.slow) for case in ("white", "AR(1) 0.5")),
        *(pytest.param(case, range(1000, 1134), marks=pytest.mark.slow) for case in CASES),
    ],
)
def test_intervals_cover(case, seeds):
    """f and zeta of modes 1, 3 and 5 within the binomial 99.9 % band, by the density that emcee samples."""
    trials = [run_trial(case, mode, seed, sampled=False) for mode in (0, 2, 4) for seed in seeds]
    for name in ("rank_frequency", "rank_zeta"):
        ranks = np.array([getattr(trial, name) for trial in trials])
        assert np.all(np.isfinite(ranks)), f"{case}: {np.count_nonzero(np.isnan(ranks))} modes not identified"
        for level in LEVELS:
            # the binomial 99.9 % band: one false alarm in a thousand checks
            low, high = binom.interval(0.999, ranks.size, level)
            hits = covered(ranks, level)
            assert low <= hits <= high, (
                f"{case}, {name}: {hits} of {ranks.size} inside the {level:.0%} interval, allowed {low}..{high}"
            )


def test_emcee_draws_the_density_that_the_study_integrates():
    """Ranks by draws and by quadrature; a rank from n effective draws has a standard error below 0.5 / sqrt(n)."""
    # Without outliers: `identify` may leave out a stretch that the study does not.
    for mode, case in ((2, "neighbour 2 %"),):
        drawn, exact = (run_trial(case, mode, 3, sampled=how) for how in (True, False))
        # Over 10 000 effective draws.
        assert drawn.rank_zeta == pytest.approx(exact.rank_zeta, abs=5 * 0.5 / np.sqrt(10000))
        assert drawn.rank_frequency == pytest.approx(exact.rank_frequency, abs=5 * 0.5 / np.sqrt(10000))
