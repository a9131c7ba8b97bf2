"""Section on damping models: best model, failures of the others, aerodynamic drag."""

import re
from dataclasses import replace

import numpy as np
import pytest
from kit import runs
from support.html_page import Page

from modalcam.pipeline import model_scores
from modalcam.report import build_report
from modalcam.report.sections import findings, worst_ratios
from modalcam.report.style import environment, significant, thousands
from sim.comparison import DragFit, DragLimit, ScoreSum
from sim.damping import DAMPING_MODELS, DampingModelEntry, compare_laws, register_damping_model
from tracker import Failure


@pytest.fixture(scope="module")
def recordings():
    return runs.compared(runs.paper_recordings())


def changed(recordings, change):
    return runs.run_result(tuple(replace(r, comparison=change(r.comparison)) for r in recordings))


def sentences(result):
    template = environment().from_string('{% import "findings.html.j2" as f %}{{ f.items(found, "p") }}')
    html = template.render(found=findings(result))
    return [Page(part).words for part in html.split("<p>")[1:] for part in ["<p>" + part]]


def test_the_findings_name_the_best_model_and_the_failures_of_the_other(recordings):
    (text,) = sentences(runs.run_result(recordings))
    assert text.startswith("Generic damping predicts better than Rayleigh damping: over 5 recordings")
    # Eq. 3 and 4 with the values of Table 2, for recordings with the same values
    assert text.endswith(
        "Rayleigh damping fails at mode 3, mode 4 and mode 5: 1.20, 2.46 and 3.02 times the measured damping."
    )
    generic, rayleigh = model_scores(recordings)
    assert rayleigh.log_density_gain.standard_errors > 10.0
    assert f"({thousands(rayleigh.log_density_gain.samples)} samples)".replace("\u202f", " ") in text
    assert rayleigh.log_density_gain.samples == sum(r.comparison.used.sum() for r in recordings)
    assert generic.crps.mean < rayleigh.crps.mean
    gain = generic.log_density.mean - rayleigh.log_density.mean
    assert gain == pytest.approx(rayleigh.log_density_gain.mean)


def test_models_with_equal_scores(recordings):
    def equal(comparison):
        nothing = ScoreSum(0.4, 0.5, 100)
        return replace(
            comparison,
            models=tuple(
                replace(m, log_density_gain=nothing if m.model == "rayleigh" else m.log_density_gain)
                for m in comparison.models
            ),
        )

    (text,) = sentences(changed(recordings, equal))
    assert "predict equally well over 5 recordings" in text
    assert "2.0 ± 1.1 nats" in text


def test_a_worse_first_model_is_compared_over_the_recordings_of_the_other(recordings):
    def better_rayleigh(comparison):
        generic, rayleigh = comparison.models
        gain = ScoreSum(-100.0, 0.5, 100)
        models = (generic, replace(rayleigh, log_density_gain=gain))
        return replace(comparison, models=models if comparison.mode_number < 3 else (generic,))

    (text,) = sentences(changed(recordings, better_rayleigh))
    words = "Rayleigh damping predicts better than generic damping: over 2 recordings (200 samples)"
    assert text.startswith(words)


def test_a_constant_stiffness_is_explained_where_it_differs(recordings):
    def constant_stiffness(comparison):
        rayleigh = comparison.models[1]
        factor = 16.6 if comparison.mode_number == 1 else 1.0
        ratio = factor * rayleigh.damping_ratio
        constant = replace(rayleigh, model="rayleigh_constant_k", damping_ratio=ratio, note="")
        return replace(comparison, models=(*comparison.models, constant), tip_amplitude_mm=20.0)

    result = changed(recordings, constant_stiffness)
    text = sentences(result)[1]
    assert "overestimates damping as soon as elements rotate" in text
    assert "axial strain, which βK damps" in text
    assert "With 20 mm at the tip, mode 1 decays at 16.6 % instead of 1.00 %" in text


def test_drag_is_reported_if_detected_and_limited_otherwise(recordings):
    fit = DragFit(2.01, 0.03, 1.961, 2.059, 0.01, 1e-4, 1.857, 1e-5, 1.9, 0.02, 1.204, 1.0)
    detected = sentences(changed(recordings[:1], lambda c: replace(c, drag=fit)))[-1]
    assert detected.startswith("Aerodynamic drag damps mode 1")
    assert "the drag coefficient is 2.010 ± 0.030 (90 %: 1.96 to 2.06)" in detected
    assert "the damping ratio at small amplitude is 1.000 ± 0.010 %" in detected
    limits = iter([0.3, np.nan, 0.088, 2.0, 5.0])
    drags = (DragLimit("no rise", drag_coefficient_q95=limit) for limit in limits)
    text = sentences(changed(recordings, lambda c: replace(c, drag=next(drags))))[-1]
    assert "Aerodynamic drag was not detected: drag coefficient below 0.088" in text


def test_the_worst_mode_of_each_model(recordings):
    generic, rayleigh = worst_ratios(runs.run_result(recordings))
    assert generic.accurate
    assert (rayleigh.model, rayleigh.number) == ("rayleigh", 5)
    assert rayleigh.ratio == pytest.approx(3.02, abs=0.01)


@pytest.mark.usefixtures("no_figures")
def test_measured_and_simulated_shift_of_the_frequency(recordings):
    assert "−0.0110 ± 0.0020 −0.012" in Page(build_report(runs.run_result(recordings[:1]))).words


def test_without_a_simulation_there_are_no_findings():
    result = runs.run_result(runs.paper_recordings(1))
    assert (findings(result), worst_ratios(result)) == (None, [])


def test_a_damping_model_of_a_plugin_is_in_the_report(recordings):
    entry = DampingModelEntry("toy", "toy damping", "A toy.", "#123456", "#abcdef", build=None, marker="P")
    register_damping_model(entry)
    try:
        comparison = recordings[0].comparison
        toy = replace(comparison.models[1], model="toy")
        comparison = replace(comparison, models=(*comparison.models, toy))
        html = build_report(runs.run_result([replace(recordings[0], comparison=comparison)]))
    finally:
        del DAMPING_MODELS["toy"]
    words = Page(html).words
    assert "Toy damping" in words
    assert "Toy damping (nrmse" in words, "the figure of the simulated decays"
    assert "simulated, toy damping" in words, "the legend of the damping ratios"
    assert '<td class="model toy">' in html
    assert html.count("var(--damping-toy)") > 2
    assert "--damping-toy: #abcdef" in html


def laws_shown(beam):
    template = environment().from_string('{% include "laws.html.j2" %}')
    return Page(template.render(result=runs.run_result(beam=beam))).words


def test_damping_laws_are_listed_with_the_prediction_of_each_mode_and_the_parts():
    beam = runs.beam_result(elements=6)
    laws, words = beam.laws, laws_shown(beam)
    best = DAMPING_MODELS[laws.keys[0]]
    assert f"{best.name} is the most probable ({significant(100 * laws.probability[0], 2)} %)" in words
    # Table 2: no law is probable enough
    assert "the measured modes do not decide between the laws" in words
    by_mode = laws.left_out_probability
    for k, number in enumerate(laws.measured.numbers):
        name = DAMPING_MODELS[laws.keys[int(np.argmax(by_mode[:, k]))]].name
        assert f"mode {number} agrees best with {name} (" in words
    assert "Viscous air (%)" in words


def test_two_laws_of_one_evidence_are_named_together():
    """Ratios that follow no frequency: a value for each mode, by whatever curve between the modes."""
    beam = runs.beam_result(elements=6)
    ratios = (3e-3, 3e-2, 3e-4, 1e-2, 8e-4)
    irregular = replace(beam.laws.measured, damping_ratio=ratios, damping_sd=(1e-6,) * 5)
    words = laws_shown(replace(beam, laws=compare_laws(irregular)))
    assert (
        "Of 18 laws, generic damping or Caughey damping, which differ between the modes only, is the most"
        in words
    )
    assert float(re.search(r"most probable \(([\d.]+) %\), with odds of", words)[1]) > 99
    assert "do not decide" not in words


def test_too_few_modes_for_laws_are_named():
    few = replace(runs.beam_result(elements=6), laws=Failure("damping laws need at least 3 modes, found 2"))
    assert laws_shown(few) == "Damping laws need at least 3 modes, found 2."
    assert laws_shown(None) == ""
