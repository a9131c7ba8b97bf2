"""What the report says of the models: which one predicts, where the others fail, and what the air does."""

from dataclasses import replace

import numpy as np
import pytest
from support import report_runs as runs

from modalcam.pipeline.scoreboard import model_scores
from modalcam.report.sections.scores import score_rows, shift_rows, verdict
from sim.comparison import DragFit, DragLimit, ScoreSum


@pytest.fixture(scope="module")
def recordings():
    return runs.compared(runs.paper_recordings())


def changed(recordings, change):
    return runs.run_result(tuple(replace(r, comparison=change(r.comparison)) for r in recordings))


def test_the_verdict_names_the_model_that_predicts_and_where_the_other_fails(recordings):
    (text,) = verdict(runs.run_result(recordings))
    assert text.startswith("Generic damping predicts better than Rayleigh damping: over 5 recordings")
    # Table 2 through Eq. 3 and 4, on recordings with Table 2's own values
    assert text.endswith(
        "Rayleigh damping fails at mode 3, mode 4 and mode 5: 1.20, 2.46 and 3.02 times the measured damping."
    )
    generic, rayleigh = model_scores(recordings)
    assert rayleigh.log_density_gain.standard_errors > 10.0
    assert f"({rayleigh.log_density_gain.samples} samples)" in text
    assert rayleigh.log_density_gain.samples == sum(r.comparison.used.sum() for r in recordings)
    assert generic.crps.mean < rayleigh.crps.mean
    assert generic.log_density.mean - rayleigh.log_density.mean == pytest.approx(
        rayleigh.log_density_gain.mean
    )


def test_models_that_cannot_be_told_apart_are_said_to_be(recordings):
    def equal(comparison):
        nothing = ScoreSum(0.4, 0.5, 100)
        return replace(
            comparison,
            models=tuple(
                replace(m, log_density_gain=nothing if m.model == "rayleigh" else m.log_density_gain)
                for m in comparison.models
            ),
        )

    (text,) = verdict(changed(recordings, equal))
    assert "predict equally well over 5 recordings" in text
    assert "2.0 ± 1.1 nats" in text


def test_a_constant_stiffness_is_explained_where_it_shows(recordings):
    def trap(comparison):
        beside = comparison.models[1]
        many = 16.6 if comparison.mode_number == 1 else 1.0
        constant = replace(
            beside, model="rayleigh_constant_k", damping_ratio=many * beside.damping_ratio, note=""
        )
        return replace(comparison, models=(*comparison.models, constant), tip_amplitude_mm=20.0)

    result = changed(recordings, trap)
    text = verdict(result)[1]
    assert "βK damps it" in text
    assert "With 20 mm at the tip mode 1 then decays at 16.6 % instead of 1.00 %" in text
    assert [row.name for row in score_rows(result)][-1] == "Rayleigh damping with constant K"


def test_the_air_is_spoken_of_where_it_shows_and_where_it_does_not(recordings):
    fit = DragFit(2.01, 0.03, 1.961, 2.059, 0.01, 1e-4, 1.857, 1e-5, 1.9, 0.02, 1.204, 1.0)
    shows = changed(recordings[:1], lambda c: replace(c, drag=fit))
    assert "its drag coefficient is 2.010 ± 0.030 (90 %: 1.96 to 2.06)" in verdict(shows)[-1]
    assert "the damping ratio at small amplitude is 1.000 ± 0.010 %" in verdict(shows)[-1]
    limits = iter([0.3, np.nan, 0.088, 2.0, 5.0])
    quiet = changed(recordings, lambda c: replace(c, drag=DragLimit(next(limits), "no rise")))
    assert (
        "No recording shows quadratic drag of the air: its coefficient is below 0.088" in verdict(quiet)[-1]
    )


def test_measured_and_simulated_shift_of_the_frequency_stand_side_by_side(recordings):
    rows = shift_rows(runs.run_result(recordings))
    assert [row.mode for row in rows] == ["1", "2", "3", "4", "5"]
    assert (rows[0].measured, rows[0].simulated) == ("−0.0110 ± 0.0020", "−0.012")


def test_nothing_simulated_says_nothing():
    result = runs.run_result(runs.paper_recordings(1))
    assert (verdict(result), score_rows(result), shift_rows(result)) == ((), (), ())
