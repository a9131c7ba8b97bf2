"""A plan in the terminal and as a page."""

from kit.beams import BEAM
from support.command import finished
from support.html_page import assert_sound

from modalcam.apps.plan import Plan, TrialSummary, plan_html, predict
from modalcam.report.style import significant


def test_the_command_prints_the_plan_and_writes_the_page(tmp_path):
    config = tmp_path / "experiment.toml"
    config.write_text(
        "[camera]\nfps = 500\nmm_per_px = 2.0\n[markers]\nkind = 'blob'\nsize_mm = 20.0\n"
        "positions_mm = [190.0, 390.0]\n[plan]\nmodes = [2]\n[beam]\n"
        + "".join(f"{k} = {v}\n" for k, v in BEAM.items())
    )
    out = tmp_path / "plan.html"
    assert "10.57" in finished("plan", config, "-o", out)
    found = assert_sound(out.read_text(encoding="utf-8"))
    assert "script" not in found.tags
    assert "10.579 ±" in found.words
    assert "± is one standard deviation" in found.words
    assert "Tip amplitudes of 10 mm over the mode number squared" in found.words


def test_trials_are_shown_with_the_prediction_and_the_reasons_of_failures(plan_of):
    request = plan_of(plan={"modes": [2]})
    modes = predict(request)
    sd = modes[0].damping_sd
    trials = TrialSummary(2, 4, 5, 1.1 * sd, ("no marker was seen",))
    words = assert_sound(plan_html(Plan(request, modes, trials=(trials,)))).words
    assert "1.10 of predicted" in words
    assert f"± {significant(100.0 * sd, 2)}" in words, "one sd, as in a run"
    assert "identified in 4 of 5 rendered recordings. No marker was seen." in words


def test_a_plan_is_plotted_with_its_intervals(plan_of):
    request = plan_of()
    axes = Plan(request, predict(request)).plot()
    assert "damping ratio" in axes.get_ylabel()
    assert [len(line.get_xdata()) for line in axes.lines[:1]] == [2]
