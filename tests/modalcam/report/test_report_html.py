"""The HTML of the report: required and forbidden content."""

import re
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from kit import runs
from support.html_page import Page, assert_sound

import modalcam.report
from modal_id import FailedMode
from modalcam.pipeline import RecordingResult
from modalcam.report import build_report
from modalcam.report.sections import worst_ratios
from modalcam.report.style import with_sd
from modalcam.tables import summary
from sim.beam import ElasticClamp
from sim.updating import ClampPosterior, PointMassPosterior
from tracker import FailedTracking, Failure


def test_the_page_is_valid_and_small(paper_html):
    page = assert_sound(paper_html)
    assert "Content-Security-Policy" in page.values("http-equiv")
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'" in " ".join(page.values("content"))
    assert len(paper_html.encode()) < 2_000_000, "the budget of five recordings is 2 MB"


def test_a_large_recording_stays_below_0_8_mb(build):
    shape = {"positions_mm": np.linspace(10.0, 490.0, 30), "width": 900, "height": 900}
    large = runs.recording(0, fps=5000, seconds=1.0, **shape)
    html = build(runs.run_result(runs.compared([large])))
    assert_sound(html)
    assert len(html.encode()) < 800_000


def test_tables_contain_the_results_of_the_run(paper_run, paper_html):
    values = [float(v) for v in Page(paper_html).values("value")]
    for recording in paper_run.recordings:
        for mode in recording.identification.modes:
            assert mode.frequency_hz in values
            assert mode.damping_ratio in values
        for model in recording.comparison.models:
            assert {model.damping_ratio, model.frequency_hz, model.nrmse} <= set(values)
    updated = paper_run.beam.updated
    medians = np.median(updated.predicted_hz[:, :5], axis=0)
    assert {*updated.paper.updated_hz, *updated.uniform.updated_hz, *medians} <= set(values)


def test_updating_states_what_the_data_and_the_prior_determine(paper_run, paper_html):
    updated, words = paper_run.beam.updated, Page(paper_html).words
    found, bound = updated.bayesian, f"{100 * updated.paper.smallest_bound:.1f} %"
    all_of_them = found.determined + found.undetermined
    numbers = rf"\b{found.determined} directions .*\b{all_of_them} \w+; .*\b{found.undetermined}\b"
    assert re.search(numbers, words)
    assert f"{len(updated.paper.at_bound)} variables" in words
    assert re.search(rf"Without gravity.{{0,80}} {bound}", words)
    assert re.search(r"modes favour smooth .* with gravity", words) is not None
    assert updated.evidence.models[0].name == "smooth+gravity"
    assert "No shapes were measured" in words


def test_the_places_of_a_point_mass_are_listed_with_its_odds(build):
    cells = np.full(5, 0.1)
    found = PointMassPosterior(
        position_m=np.cumsum(cells) - 0.05,
        cell_m=cells,
        weight=np.array([0.03, 0.35, 0.02, 0.58, 0.02]),
        mass_kg=np.full(5, 4e-4),
        mass_sd_kg=np.full(5, 1e-9),
        log_odds=-np.log(20.0),
    )
    beam = runs.beam_result(elements=6)
    updated = replace(beam.updated, point_mass=found)
    result = runs.run_result([runs.recording(0)], beam=replace(beam, updated=updated))
    words = Page(build(result)).words
    assert "lacks has odds of 20 : 1 against it" in words
    assert re.search(r"300.0 to 400.0 mm with 0.40 to 0.40 g \(58 %\); or at 100.0 to 200.0 mm", words)
    body = summary(result)["beam"]["updating"]["point_mass"]
    assert body["most_probable"]["position_m"] == pytest.approx(0.35)
    assert [region["probability"] for region in body["regions_90"]] == pytest.approx([0.58, 0.35])


def test_the_stiffness_of_the_clamp_is_listed_with_its_odds(build):
    draws = np.column_stack([np.geomspace(1e3, 1e8, 2001), np.geomspace(1.0, 2.0, 2001)])
    found = ClampPosterior(
        most_probable=ElasticClamp(1.5, 2e4),
        stiffness=draws,
        prior_median=np.array([1e4, 1.0]),
        prior_log_sd=np.array([3.0, 2.5]),
        effective_draws=1500.0,
        log_odds=np.log(20.0),
    )
    beam = runs.beam_result(elements=6)
    updated = replace(beam.updated, clamp=found)
    result = runs.run_result([runs.recording(0)], beam=replace(beam, updated=updated))
    words = Page(build(result)).words
    assert "An elastic clamp has odds of 20 : 1 in its favour" in words
    # a tenth of the draws of the first is below the limit of a side that is not closed, a twentieth of the second
    assert "1.0 to 1.9 N m/rad against rotation and above 3162 N/m against translation" in words
    clamp = summary(result)["beam"]["updating"]["clamp"]
    assert clamp["translation_interval_90_n_m"] == [pytest.approx(10**3.5), None]
    assert clamp["most_probable"]["rotation_n_m_rad"] == 1.5


def test_the_first_figure_says_how_far_rayleigh_damping_fitted_to_all_modes_is_off(paper_run, paper_html):
    """Least squares of Eq. 3 over the five measured damping ratios, both coefficients positive."""
    modes = [recording.identification.target for recording in paper_run.recordings]
    omega, ratio = np.array([(2.0 * np.pi * m.frequency_hz, m.damping_ratio) for m in modes]).T
    columns = np.column_stack([0.5 / omega, 0.5 * omega])
    fitted = np.linalg.lstsq(columns, ratio, rcond=None)[0]
    assert np.all(fitted > 0.0)
    factors = columns @ fitted / ratio
    words = Page(paper_html).words
    for digits, worst in ((2, factors.argmin()), (1, factors.argmax())):
        assert f"×{factors[worst]:.{digits}f} in mode {worst + 1}" in words


def test_every_figure_has_a_caption(paper_html):
    page = Page(paper_html)
    assert page.values("role").count("img") == page.tags.count("svg")
    assert page.tags.count("figure") == page.tags.count("svg")
    assert "Damping ratio against frequency" in page.words
    # Five recordings with ten figures (mode 1: nine, too few cycles for windows), a frame twice, a strip and a shape
    # in motion; three of all, and the frames of two recordings.
    assert page.tags.count("svg") == 5 * 14 - 1 + 3 + 2
    # How to read a figure stands once in the page, linked from each.
    assert page.words.count("The residual at the bottom should resemble noise") == 1
    assert page.values("href").count("#read-decay") == 5


def test_the_summary_gives_the_main_results(paper_run, paper_html):
    words = Page(paper_html).words
    modes = [recording.identification.target for recording in paper_run.recordings]
    f, z = ([getattr(mode, name) for mode in modes] for name in ("frequency_hz", "damping_ratio"))
    ranges = (
        rf"{len(modes)} modes .*{min(f):.3f} .*{max(f):.2f} Hz .*{100 * min(z):.2f} .*{100 * max(z):.1f} %"
    )
    assert re.search(ranges, words)
    generic, rayleigh = worst_ratios(paper_run)
    assert re.search(rf"Rayleigh damping .* mode {rayleigh.number} .*{rayleigh.ratio:.1f}", words)
    assert generic.accurate


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("flag", ["AMPLITUDE_DEPENDENT", "LOW_SNR"])
def test_values_of_another_amplitude_are_never_alone(build, flag):
    recording = runs.paper_recordings(1)[0]
    found = recording.identification
    marked = tuple(replace(mode, flags=(flag,)) for mode in found.modes)
    result = runs.run_result([replace(recording, identification=replace(found, modes=marked))])
    words = Page(build(result)).words
    headline = words[: words.index("Modes Checks Simulation")]
    values = with_sd(100 * found.modes[0].damping_ratio, 100 * found.modes[0].damping_ratio_sd)
    assert f"damping ratio {values} %" in headline
    assert ("At small amplitude" in headline) == (flag == "AMPLITUDE_DEPENDENT")


def test_the_page_reveals_neither_machine_nor_date(paper_html):
    assert "/home/" not in paper_html
    assert not re.search(r"20[2-9]\d-\d\d-\d\d", paper_html)
    assert "modalcam run …/videos -o …/out" in Page(paper_html).words


def test_an_empty_run_has_a_page(build):
    page = assert_sound(build(runs.run_result()))
    assert "No recording was found" in page.words
    assert "No mode was identified." in page.words


def test_a_playback_rate_is_an_alert(build):
    page = assert_sound(build(runs.run_result([runs.recording(0, time_axis=runs.PLAYBACK, seconds=1.0)])))
    assert "The time axis is a playback rate" in page.words
    assert "container’s rate is only a playback rate" in page.words
    assert "alert danger" in page.values("class")
    assert "--fps" in page.words
    verdict = r"Damping ratio \S+ ± \S+ %\. The frequency is unknown: the recorded frame rate is missing\."
    assert len(re.findall(verdict, page.words)) == 2, "at the top, and at the recording"


@pytest.mark.parametrize(("codec", "warned"), [("h264", True), ("mjpeg", False), ("ffv1", False)])
def test_compressed_and_damaged_footage_is_reported(codec, warned, build):
    good = runs.recording(0, seconds=1.0)
    coding = {"codec": codec, "lossy": codec != "ffv1", "predictive": codec == "h264"}
    decode = replace(good.tracks.decode, **coding, frames_corrupt=2)
    recording = replace(good, tracks=replace(good.tracks, decode=decode), identification=None, series=None)
    words = Page(build(runs.run_result([recording]))).words
    assert ("Compressed footage" in words) is warned
    assert "Damaged frames" in words


@pytest.mark.usefixtures("no_figures")
def test_a_posterior_that_has_not_converged_is_reported(build):
    good = runs.recording(0, seconds=1.0)
    mode = good.identification.modes[0]
    mode = replace(mode, posterior=replace(mode.posterior, r_hat=(1.2, float("nan"))))
    recording = replace(good, identification=replace(good.identification, modes=(mode,)))
    assert "A posterior has not converged" in Page(build(runs.run_result([recording]))).words


def test_a_good_time_axis_raises_no_alert(paper_html):
    assert "alert danger" not in Page(paper_html).values("class")


@pytest.mark.parametrize(
    ("tracks", "identification", "reason"),
    [
        (
            FailedTracking("no marker of DICT_4X4_50 was seen", "a.avi"),
            None,
            "No marker of DICT_4X4_50 was seen.",
        ),
        (FailedTracking("dark", "a.avi", first_frame=np.full((60, 80), 7, np.uint8)), None, "Dark."),
        (None, Failure("all values are zero", "a.avi"), "All values are zero."),
        (None, None, "nothing was identified"),
    ],
)
def test_failures_have_a_section_with_the_reason(tracks, identification, reason, build):
    failed = RecordingResult("a", "a.avi", "", 1, tracks=tracks, identification=identification)
    page = assert_sound(build(runs.run_result([failed, runs.recording(1, seconds=1.0)])))
    assert reason in page.words
    assert "1 of 2 recordings gave a result" in page.words
    # The good recording has its first frame and a strip of start, onset, largest motion and end.
    assert page.tags.count("image") == 5 + (tracks is not None and tracks.first_frame is not None)


def test_no_modes_at_all(build):
    good = runs.recording(0, seconds=1.0)
    found = replace(
        good.identification,
        modes=(),
        failed=(FailedMode("only noise was recorded", target=True),),
        fitted=np.full_like(good.identification.fitted, np.nan),
        used=np.zeros_like(good.identification.used),
    )
    page = assert_sound(build(runs.run_result([replace(good, identification=found)])))
    assert "Only noise was recorded." in page.words
    assert "No mode could be identified. The reasons are listed below." in page.words


def test_a_failed_comparison_gives_its_reason(build, paper_run):
    failed = Failure("the step at 0.1 s diverged", "a.avi")
    recording = replace(runs.recording(0, seconds=1.0), comparison=failed)
    beam = replace(paper_run.beam, updated=None, updated_modes=None)
    words = Page(build(runs.run_result([recording], beam=beam))).words
    assert "The decay was not simulated: The step at 0.1 s diverged." in words


@pytest.mark.parametrize(
    "change",
    [
        {"scale": False, "flags": ("AMPLITUDE_DEPENDENT", "LOW_SNR")},
        {"positions_mm": np.full(3, np.nan)},
        {"positions_mm": np.array([490.0]), "fps": 60, "seconds": 2.0},
    ],
)
def test_recordings_of_every_kind_have_a_page(change, build):
    assert_sound(build(runs.run_result([runs.recording(0, **{"seconds": 1.0, **change})])))


def test_a_report_from_the_series_alone(build):
    recording = replace(runs.recording(0, seconds=1.0), tracks=None)
    page = assert_sound(build(runs.run_result([recording])))
    assert "Nyquist frequency" in page.words


def test_a_report_without_uncertainties(build):
    nan = float("nan")
    good = runs.recording(0, seconds=1.0)
    mode = replace(good.identification.modes[0], shape_sd=np.full(5, nan), mac=nan, number=None, target=False)
    onset = replace(good.identification.onset, sd_s=nan)
    found = replace(good.identification, modes=(mode,), onset=onset, residual_sd=np.full(5, nan))
    assert_sound(build(runs.run_result([replace(good, identification=found, mode=None)])))


def test_hostile_names_are_escaped_everywhere(hostile_html):
    html = hostile_html
    page = assert_sound(html)
    assert list(page.tags).count("script") == 1, "that of the page"
    html.encode("utf-8")
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f\u200e\u200f\u202a-\u202e\u2066-\u2069\ufffe]", html)
    assert "<img src=x onerror=window.PWN=1>.mp4" in page.text
    assert "{{7*7}}{% raw %}.avi" in page.text
    assert "$x_1$^.avi" in page.text
    assert "rtl\\u202egpj.avi" in page.text
    assert 'url(#x) style="fill:#1c2126" var(--ink).avi' in page.text


def test_figures_of_many_recordings_are_omitted_with_a_note(build):
    one = RecordingResult("a", "a.avi", "", None, series=runs.recording(0, seconds=1.0).series)
    page = Page(build(runs.run_result([replace(one, name=f"a{i}", file=f"a{i}.avi") for i in range(60)])))
    assert "The page contains 60 recordings, so their figures are not drawn." in page.words


def test_markup_is_declared_in_one_place():
    package = Path(modalcam.report.__file__).parent
    assert [p.name for p in package.rglob("*.py") if re.search(r"\bMarkup\(", p.read_text())] == ["text.py"]
    templates = "".join(p.read_text() for p in package.rglob("*.j2"))
    assert "safe" not in re.findall(r"\|\s*(\w+)", templates)
    assert "autoescape" not in templates
    assert re.findall("<script[^/]*/script>", templates) == ["<script>{{ script }}</script>"]


@pytest.mark.parametrize("name", ["used", "fitted"])
def test_a_fit_without_data(name, build):
    good = runs.recording(0, seconds=1.0)
    values = getattr(good.identification, name)
    empty = np.zeros_like(values) if name == "used" else np.full_like(values, np.nan)
    found = replace(good.identification, **{name: empty})
    assert_sound(build(runs.run_result([replace(good, identification=found)])))


def test_the_files_beside_the_page_are_linked():
    contents = [("tracks/a b%.csv", "tracks"), ("tracks/<c>.csv", "tracks"), ("modes.csv", "modes of `mode`")]
    html = build_report(runs.run_result([]), contents=contents)
    page = Page(html)
    links = [unquote(v) for v in page.values("href") if not v.startswith(("#", "https://doi.org/"))]
    assert links == ["modes.csv", contents[0][0], contents[1][0]]
    assert "<c>" not in html
    assert "tracks/<c>.csv" in page.words
