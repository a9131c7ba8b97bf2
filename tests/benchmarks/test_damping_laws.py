"""The study of damping laws: its page, and on simulated sets the law that is named and the predicted modes."""

from dataclasses import replace

import numpy as np
import pytest
from support.paths import ROOT

from benchmarks.laws import KEYS, LAWS, SURE, drawn, measured, named, paper, tables, truth
from modalcam.pipeline import damping_candidates
from sim import MEASURED_FREQUENCY_HZ, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import law as law_module

PAGE = (ROOT / "docs" / "studies" / "laws.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("key", "lines"), tables().items(), ids=list(tables()))
def test_the_page_prints_the_computed_tables(key, lines):
    hint = "run python -m benchmarks.laws --page docs/studies/laws.md"
    assert f"<!-- {key}: begin -->\n{lines}\n<!-- {key}: end -->" in PAGE, hint


def drawn_exactly(key, rng):
    """Without scatter, and with an error of 0.1 %: the narrowest posterior."""
    zeta = truth(key, rng)
    return measured(zeta, 1e-3 * zeta)


@pytest.mark.parametrize("change", [{"spacing": 0.005}, {"scatters": 32}], ids=["spacing", "scatters"])
def test_finer_nodes_change_no_evidence(monkeypatch, change):
    rng = np.random.default_rng(4)
    sets = [paper(0.02), *(drawn_exactly(key, rng) for key in ("rayleigh_all_modes", "constant"))]
    before = [[LAWS[key].log_evidence(one) for key in KEYS] for one in sets]
    monkeypatch.setattr(law_module, "TUNING", replace(law_module.TUNING, **change))
    after = [[LAWS[key].log_evidence(one) for key in KEYS] for one in sets]
    # a twentieth of a nat changes no odds by more than 5 %; only laws within 1e-4 of the best one count
    near = np.array(before) > np.max(before, axis=1, keepdims=True) + np.log(1e-4)
    assert near.sum() > 15
    assert np.max(np.abs(np.array(after) - before)[near]) < 0.05


@pytest.mark.parametrize("key", [key for key in LAWS if key not in ("generic", "rayleigh_all_modes")])
def test_each_law_makes_a_model_with_its_damping_ratios(key):
    """Of data without scatter under the law, the simulated beam has the law's ratios."""
    zeta = truth("constant" if key == "caughey" else key, np.random.default_rng(5))
    data = replace(
        measured(zeta, 1e-3 * zeta),
        frequency_draws_hz=tuple((f,) for f in MEASURED_FREQUENCY_HZ),
        damping_draws=tuple((z,) for z in zeta),
    )
    candidate = damping_candidates((key,), paper_beam(), data)[key]
    modes = beam_modes(AncfBeam(paper_beam()), 6)
    found = candidate.model.coefficients(modes).damping_ratio
    # frequencies of the beam differ from the measured ones by up to 10 %, and the law is fitted within 1 %
    np.testing.assert_allclose(found[:5], zeta, rtol=0.11)
    assert len(candidate.draws) == 1
    if key == "kelvin_voigt":
        beta = candidate.model.beta_s
        np.testing.assert_allclose(found, 0.5 * beta * modes.omega_rad_s, rtol=1e-12)


def check_named(rows):
    """Where the probability exceeds 0.9, the law named is right in 90 % of the sets, and as often as stated."""
    sure = [(true, best) for true, best, probability in rows if probability > SURE]
    right = np.mean([true == best for true, best in sure])
    assert len(sure) > len(rows) / 4, f"only {len(sure)} of {len(rows)} sets decide"
    assert right >= 0.9, f"{right:.3f} of {len(sure)} sets name the right law"
    stated = np.array([probability for *_, probability in rows if probability > SURE])
    allowed = 3.0 * np.sqrt(np.sum(stated * (1.0 - stated))) / stated.size
    assert abs(right - stated.mean()) < allowed, f"{right:.4f} are right, {stated.mean():.4f} stated (3 sd)"
    return sure


def test_simulated_sets_name_the_law_that_made_them():
    check_named(named(4, 7))


@pytest.mark.slow
def test_200_simulated_sets_of_each_law_name_it():
    """By law too, where 2.3 sigma of chance are allowed."""
    sure = check_named(named(200, 8))
    for key in KEYS:
        for side in (0, 1):
            right = [true == best for true, best in sure if (true, best)[side] == key]
            allowed = 2.3 * np.sqrt(0.09 / max(len(right), 1))
            assert np.mean(right) >= 0.9 - allowed, f"{key}: {np.mean(right):.3f} of {len(right)}"


def covered(keys, count, seed):
    rng, inside = np.random.default_rng(seed), []
    for key in keys:
        for _ in range(count):
            one, zeta = drawn(key, rng)
            inside += [p.q05 < z < p.q95 for p, z in zip(LAWS[key].fit(one).left_out, zeta, strict=True)]
    return float(np.mean(inside)), len(inside)


def test_intervals_of_modes_left_out_hold_the_truth():
    share, count = covered(("constant", "mass_and_constant", "thermoelastic"), 20, 9)
    # five modes of a set are correlated: as many independent values as sets; 2.6 sigma
    assert abs(share - 0.9) < 2.6 * np.sqrt(0.09 * 5 / count), f"{share:.3f} of {count}"


@pytest.mark.slow
def test_intervals_of_modes_left_out_hold_the_truth_for_all_laws():
    share, count = covered([key for key in KEYS if key != "generic"], 100, 10)
    # from moments: a mixture of scatters has heavier tails and a narrower middle than a normal distribution
    assert 0.88 < share < 0.94, f"{share:.3f} of {count}"
