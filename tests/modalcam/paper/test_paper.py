"""`modalcam paper`: the paper's tables recomputed, and what the page says where the numbers are others."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support import report_runs as runs
from support.html_page import Page, assert_sound
from support.sim_theory import euler_bernoulli_hz, rayleigh_ritz_hz

from modalcam.paper import checks, table2, table3
from modalcam.paper.bounds import ending_at_bound
from modalcam.paper.figures import variables_figure
from modalcam.paper.page import PaperInput, paper_html, paper_page
from modalcam.paper.recomputed import recompute
from modalcam.paper.recorded import beam_differences, target_modes
from modalcam.paper.show import numbers
from modalcam.paper.truth import TrueMode, Truth, read_truth
from modalcam.paper.words import listed, modes_named, of_all, percent_range, signed_percent, signed_range
from modalcam.pipeline.results import BeamResult
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.beam.properties import PointMass
from sim.reference import paper_tables as printed
from sim.reference.paper_beam import paper_beam

STANDARD, OPTIMUM = np.array(printed.TABLE_3_STANDARD_HZ), np.array(printed.TABLE_3_OPTIMUM_HZ)
NOTHING = Truth({})


@cache
def paper():
    return recompute()


@cache
def run_of_table_2():
    """Decays with Table 2's frequencies and damping ratios, of the paper's beam."""
    beam = BeamResult(
        standard=paper_beam(),
        standard_modes=runs.beam_theory(),
        updated=paper().optimum.to_test,
        rayleigh_alpha_1_s=runs.RAYLEIGH_ALPHA_1_S,
        rayleigh_beta_s=runs.RAYLEIGH_BETA_S,
    )
    return runs.run_result(runs.compared(runs.paper_recordings()), beam=beam)


@cache
def page():
    return paper_page(PaperInput(run_of_table_2(), paper(), NOTHING))


def test_the_standard_column_is_theory_without_gravity_for_the_hidden_density():
    s = paper().standard
    assert np.abs(s.handbook_density_hz / STANDARD - 1.0).max() < 1e-3, "required: 0.1 % with 7850 kg/m3"
    assert np.all(np.abs(s.printed_density_hz / STANDARD - 1.0 + 0.0091) < 0.0004), "8000 kg/m3 is 0.9 % low"
    assert s.best_density_kg_m3 == pytest.approx(7850.0, rel=1e-3)
    # The mesh of 20 elements is within 2e-4 of theory in mode 5; 18 polynomials are exact to far more.
    beam = printed.TABLE_1_STANDARD.beam("none")
    np.testing.assert_allclose(s.printed_density_hz, euler_bernoulli_hz(beam, 5), rtol=2e-4)
    np.testing.assert_allclose(s.hanging_hz, rayleigh_ritz_hz(beam, 5, tension_sign=1.0), rtol=2e-4)
    np.testing.assert_allclose(s.standing_hz, rayleigh_ritz_hz(beam, 5, tension_sign=-1.0), rtol=2e-4)


def test_the_optimum_column_is_reached_by_the_papers_variables_within_their_bound():
    reached = paper().optimum.reached
    found = beam_modes(AncfBeam(reached.properties), 5).frequency_hz
    assert np.abs(found / OPTIMUM - 1.0).max() < 1e-3, "required: 0.1 %"
    # Two eigensolvers; round-off of the lowest of 80 modes over five decades of frequency.
    np.testing.assert_allclose(found, reached.updated_hz, rtol=1e-6)
    standard = printed.TABLE_1_STANDARD.beam("none")
    factors = np.concatenate(
        [
            reached.properties.width_m / standard.width_m,
            reached.properties.thickness_m / standard.thickness_m,
            [reached.properties.density_kg_m3 / standard.density_kg_m3],
            [reached.properties.elastic_modulus_pa / standard.elastic_modulus_pa],
        ]
    )
    assert factors.size == 42
    change = np.abs(factors - 1.0)
    assert change.max() <= 0.10 + 1e-9
    assert len(reached.at_bound) == np.count_nonzero(change > 0.10 - 1e-6) > 0
    # DESIGN: about 7.8 % of each variable are needed without gravity
    assert 0.07 < reached.smallest_bound < 0.08


def test_table_1s_optimum_as_uniform_values_is_another_beam():
    o = paper().optimum
    np.testing.assert_allclose(o.uniform_hz, [1.593, 9.980, 27.946, 54.765, 90.540], atol=6e-4)
    np.testing.assert_allclose(o.uniform_hanging_hz, [1.821, 10.193, 28.167, 54.998, 90.781], atol=6e-4)
    assert "gravity" in o.to_test.evidence.models[0].name, "the test column favours the beam that hangs"


def test_the_equations_in_numbers():
    e = paper().equations
    assert e.alpha_1_s == pytest.approx(0.2282, abs=5e-5)
    assert e.beta_s == pytest.approx(3.18e-5, abs=5e-8)
    np.testing.assert_allclose(100.0 * e.rayleigh_ratio, [1.0, 0.28, 0.336, 0.566, 0.906], atol=5e-4)
    # 80 modes of double precision, frequencies over five decades
    assert e.eq6_right_error < 1e-9
    assert e.eq6_printed_error > 1.0
    assert abs(e.ratio_above) < 1e-12


def test_a_run_with_table_2s_own_modes_agrees_with_the_paper():
    found = {check.claim: check.holds for check in page().checks}
    assert len(found) == 6
    assert all(found.values()), found
    assert [row.panel for row in page().models][::2] == [
        "Fig. 2, left",
        "Fig. 2, right",
        "Fig. 3, left",
        "Fig. 3, right",
        "Fig. 4",
    ]
    ratios = {(row.number, row.model): row.ratio_full for row in page().models}
    for number, ratio in {1: 1.0, 2: 1.0, 3: 1.20, 4: 2.46, 5: 3.02}.items():
        assert ratios[number, "rayleigh"] == pytest.approx(ratio, rel=0.02), "Eq. 3 and 4 with Table 2"
        assert ratios[number, "generic"] == pytest.approx(1.0, rel=1e-9)
    assert json.loads(json.dumps(numbers(page()), allow_nan=False))["table_3"][0]["frequency_hz"][0] == 1.67


def test_other_numbers_make_other_sentences():
    modes = target_modes(run_of_table_2())
    name, third = modes[3]
    shifted = replace(
        third.posterior,
        frequency_hz=1.01 * third.posterior.frequency_hz,
        damping_ratio=0.8 * third.posterior.damping_ratio,
    )
    moved = replace(third, posterior=shifted)
    table = table2.rows({1: modes[1], 3: (name, moved)}, NOTHING)
    said = " ".join(table2.sentences(table, NOTHING))
    assert "for mode 3 ours differs by −20 %" in said
    assert "for mode 3 ours differs by +1.0 %" in said
    assert "Modes 2, 4 and 5 of the paper were not measured here." in said
    assert "simulated" not in said
    assert table2.cells(table[1].frequency).verdict == "not measured"
    verdicts = {check.claim: check.holds for check in checks.checks(table, (), paper())}
    assert verdicts["Table 2’s damping ratios lie in our 99 % intervals"] is False
    assert verdicts["Generic damping gives every mode its measured damping back"] is None


def test_a_beam_that_differs_from_the_papers_is_told_by_its_truth():
    modes = target_modes(run_of_table_2())
    truth = Truth({n: TrueMode(1.003 * modes[n][1].frequency_hz, 0.5) for n in (1, 2)})
    said = " ".join(table2.sentences(table2.rows(modes, truth), truth))
    assert "Table 2’s damping ratio in none of 2 of these modes" in said
    assert "frequencies that differ from Table 2’s by +0.30 %" in said
    assert "90 % interval in 0 of 4 cases (4 expected)" in said


@pytest.mark.parametrize("text", ["{", "[]", '{"recordings": [{"mode": 1}]}', '{"recordings": 3}'])
def test_a_damaged_truth_is_named_and_left_out(tmp_path, text):
    assert not read_truth(tmp_path).note
    (tmp_path / "truth.json").write_text(text)
    truth = read_truth(tmp_path)
    assert not truth
    assert truth.note.startswith("truth.json was not used: expected a list of recordings")


def test_the_page_is_sound_offline_and_the_same_each_time():
    html = paper_html(page())
    found = assert_sound(html)
    assert found.tags.count("figure") == found.tags.count("svg") == 5 + 2 + 2
    assert "script" not in found.tags
    words = found.words
    for text in ("0.2282", "3.18 × 10⁻⁵", "0.336, 0.566 and 0.906 %", "7850", "within 0.1 %"):
        assert text in words
    assert len(html.encode()) < 1_000_000
    again = variables_figure("paper-variables", paper().optimum.reached, title="", aim="")
    assert str(again.svg) == str(page().variables[0].svg)


def test_a_run_without_anything_still_has_the_papers_own_page():
    empty = paper_page(PaperInput(runs.run_result(not_done=("no beam was configured",)), paper(), NOTHING))
    words = assert_sound(paper_html(empty)).words
    assert "No mode of Table 2 was measured in this folder." in words
    assert "nothing beside the paper’s figures" in words
    assert "No beam was configured." in words
    assert "Within 0.062 %" in words


def test_hostile_names_stay_text():
    markers = runs.HOSTILE[:5]
    hostile = runs.recording(0, file=runs.HOSTILE[0], markers=markers, seconds=0.6)
    result = runs.run_result(
        runs.compared([hostile]), folder=runs.HOSTILE[1], command_line=runs.HOSTILE[2], not_done=runs.HOSTILE
    )
    found = assert_sound(paper_html(paper_page(PaperInput(result, paper(), NOTHING))))
    assert runs.HOSTILE[0] in found.words
    assert "onerror" not in {name for _, name, _ in found.attributes}


def update_at(*names):
    return replace(paper().optimum.reached, at_bound=names)


def test_variables_at_their_bound_are_named_in_runs():
    names = [f"width of element {n} (+10 %)" for n in (2, 3, 4, 9)] + ["density (-10 %)"]
    assert ending_at_bound(update_at(*names)) == (
        "5 of them end at the bound: density at −10 % and width of elements 2 to 4 and 9 at +10 %"
    )
    assert ending_at_bound(update_at()) == "none of them ends at the bound"
    assert ending_at_bound(update_at("width of element 1 (+10 %)")).startswith("1 of them ends")


def test_a_beam_that_is_not_the_papers_is_said_to_be_another():
    assert beam_differences(paper_beam()) == ()
    other = replace(paper_beam("standing"), density_kg_m3=7850.0, point_masses=(PointMass(0.4, 5e-4),))
    assert beam_differences(other) == (
        "density 7850 kg/m³ against 8000",
        "standing against hanging",
        "0.5 g glued on against none",
    )
    run = run_of_table_2()
    beam = replace(run.beam, standard=other)
    said = " ".join(table3.sentences(paper(), beam))
    assert "The beam configured here is not that of Table 1: density 7850 kg/m³ against 8000" in said
    assert "is not that of Table 1" not in " ".join(page().table3_says)


def test_words():
    assert listed(["a"]) == "a"
    assert listed("abc") == "a, b and c"
    assert [of_all(n, 5) for n in (0, 2, 5)] == ["none of 5", "2 of 5", "all 5"]
    assert [modes_named(n) for n in ([3], [1, 2], [3, 4, 5], [1, 3])] == [
        "mode 3",
        "modes 1 and 2",
        "modes 3 to 5",
        "modes 1 and 3",
    ]
    assert signed_percent(0.0123) == "+1.2 %"
    assert signed_percent(float("nan")) == "–"
    assert signed_range([-0.03, float("nan"), 0.01]) == "−3.0 to +1.0 %"
    assert signed_range([]) == "–"
    assert percent_range([-0.03, 0.01]) == "1.0 to 3.0 %"


def test_the_words_of_the_paper_are_beside_ours_in_table_3():
    cells = Page(paper_html(page())).values("value")
    for value in (*STANDARD, *OPTIMUM, *printed.TABLE_3_TEST_HZ):
        assert str(value) in cells
