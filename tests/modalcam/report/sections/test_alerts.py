"""Flags that matter are listed before the results, one line each; information stays in the tables."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs
from support.html_page import Page

from modal_id import Check, DrivenMotion, FittingRate
from modal_id.modes import line_effect
from modalcam.report.sections import alerts, updating_numbers
from tracker import NOT_FOUND


def with_severities(*pairs):
    """Run of one recording whose target has these (flag, severity)."""
    recording = runs.recording(0, seconds=1.5, flags=tuple(flag for flag, _ in pairs))
    found = recording.identification
    target = replace(found.target, severities=pairs)
    modes = tuple(target if mode.target else mode for mode in found.modes)
    return runs.run_result([replace(recording, identification=replace(found, modes=modes))])


def test_each_severity_has_its_place():
    pairs = (("HARMONIC", "WRONG"), ("AMPLITUDE_DEPENDENT", "INTERVAL"), ("LOW_SNR", "INFORMATION"))
    wrong, interval = alerts(with_severities(*pairs))
    assert (wrong.kind, wrong.name) == ("wrong", "HARMONIC")
    assert (interval.kind, interval.name) == ("interval", "AMPLITUDE_DEPENDENT")
    assert wrong.places == interval.places == (("r1", "recording_1, Mode 1"),)
    # 0.008 over 0.008 / 1.04 in the draws
    assert interval.effect == ""


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(("severity", "state"), [("INFORMATION", "good"), ("INTERVAL", "care")])
def test_information_alone_leaves_the_result_good(severity, state, build):
    result = with_severities(("LOW_SNR", severity))
    assert {"wrong", "interval"}.isdisjoint(a.kind for a in alerts(result)) == (state == "good")
    assert f"verdict {state}" in Page(build(result)).values("class")


@pytest.mark.usefixtures("no_figures")
def test_the_page_shows_the_curve_and_the_flags(build):
    result = with_severities(("AMPLITUDE_DEPENDENT", "INTERVAL"))
    words = Page(build(result)).words
    assert "The interval accounts for it" in words
    assert "most probable law: saturating" in words
    assert "residual power at the mode: 33 times the noise; with the curve 1.1 times" in words


def test_a_driven_motion_is_listed_with_its_frequency():
    recording = runs.recording(0, seconds=1.5)
    line = DrivenMotion(20.0, 0.001, 3.2, "px")
    found = replace(recording.identification, modes=(), driven=(line,))
    (alert,) = alerts(runs.run_result([replace(recording, identification=found)]))
    assert (alert.kind, alert.name) == ("wrong", "DRIVEN")
    assert alert.places == (("r1", f"{recording.name}, 20.00 Hz"),)


@pytest.mark.usefixtures("no_figures")
def test_a_rate_that_does_not_fit_the_beam_is_the_first_failed_check(build):
    recording = runs.recording(0, seconds=1.5, flags=("HARMONIC",))
    fitting = FittingRate(30.0, (500.0, 500.0), 500.0 / 30.0, 3.192, 4)
    found = replace(recording.identification, fitting_rate=fitting)
    words = Page(build(runs.run_result([replace(recording, identification=found)]))).words
    _, _, first = words.partition("First of ")
    words = "The recorded rate does not fit the beam: 500 Hz fits, not 30 Hz: a ratio of 16.7 (recording_1)."
    assert first.partition(": ")[2].replace(" .", ".").startswith(words)


@pytest.mark.parametrize(
    ("share", "kind"), [(0.1, None), (0.3, "interval"), (0.6, "wrong")], ids=["few", "many", "most"]
)
def test_missing_frames_matter_by_their_share(share, kind):
    """A tenth of the frames raises standard deviations by 5 %, three tenths by 20 %; most may be a selection."""
    recording = runs.recording(0, seconds=1.5)
    tracks = recording.tracks
    flags = np.zeros_like(tracks.flags)
    flags[: round(share * tracks.frame.size), 0] = NOT_FOUND.value
    result = runs.run_result([replace(recording, tracks=replace(tracks, flags=flags))])
    found = [alert for alert in alerts(result) if alert.name == "NOT_FOUND"]
    assert [alert.kind for alert in found] == ([kind] if kind else [])
    if kind:
        assert f"marker {tracks.markers[0]} ({100 * share:.0f} % of its frames)" in found[0].places[0][1]


def test_checks_are_in_order_of_their_effect():
    result = with_severities(("AMPLITUDE_DEPENDENT", "INTERVAL"), ("HARMONIC", "WRONG"))
    (recording,) = result.recordings
    mode = recording.identification.modes[0]
    changed = {"r_hat": (1.2, 1.0), "laplace_sd": (1.0, 0.4 * mode.damping_ratio_sd)}
    mode = replace(mode, posterior=replace(mode.posterior, **changed))
    tracks = replace(recording.tracks, time_axis=runs.PLAYBACK)
    found = replace(recording.identification, modes=(mode,))
    failed = runs.run_result([replace(recording, identification=found, tracks=tracks)])
    check = Check("kurtosis of the residual", 9.0, 3.0, 0.0025, "Cause.", "Remedy.", 26.84)
    views = [{"anchor": "r1", "recording": recording, "checks": (check,), "mpc": 0.5}]
    ranked = alerts(failed, views)
    assert [a.kind for a in ranked] == ["playback", "wrong", "sampler", "interval", "fit", "phase"]
    assert ranked[3].effect == "2.5", "the sd is 1 / 0.4 of that for white noise"
    assert ranked[4].places == (("r1", "recording_1 (26.8 Hz; p < 0.003)"),)
    assert (ranked[4].brief, ranked[4].largest) == (("recording recording_1 (line at 26.8 Hz)",), ""), (
        "no mode, hence no effect"
    )
    assert ranked[5].places == (("r1", "recording_1 (0.5000)"),)


@pytest.mark.parametrize(
    ("shares", "kind", "largest"),
    [
        ((0.5, 2.0), "fit", "may change the frequency by 2.0 sd and the damping ratio by 1.0 sd."),
        (
            (0.1, 0.2),
            "slight",
            "shifts frequency and damping ratio by less than 0.2 of their standard deviations.",
        ),
    ],
)
def test_the_largest_effect_of_a_check_decides_whether_it_failed(shares, kind, largest):
    """The effect of each line is that of `line_effect` over the sd of the mode, which the test sets."""
    recording = runs.recording(2, number=3, frequency_hz=26.84, seconds=1.5)
    found = recording.identification
    line, two = line_effect(found, found.target, 40.0), np.array([[-1.0, 1.0]])
    views = []
    for anchor, share in zip(("r1", "r2"), shares, strict=True):
        posterior = replace(
            found.target.posterior,
            frequency_hz=found.target.frequency_hz + line.frequency_hz / share * two,
            damping_ratio=found.target.damping_ratio + line.damping_ratio / min(share, 1.0) * two,
        )
        check = Check("unmodelled vibration", 9.0, 3.0, 0.0025, "Cause.", "Remedy.", 40.0)
        mode = replace(found.target, posterior=posterior)
        view = {"anchor": anchor, "recording": recording, "found": found, "mode": mode}
        views.append(view | {"checks": (check,), "mpc": 1.0})
    (alert,) = alerts(runs.run_result([recording]), views)
    assert alert.kind == kind
    assert alert.brief == ("recording recording_3 (line at 40.0 Hz)",) * 2
    assert alert.largest == f"The line with the largest effect {largest}"


def test_an_updated_beam_far_from_the_configured_one_is_a_failed_check(paper_run):
    updated = paper_run.beam.updated
    largest = np.max(np.abs(updated.bayesian.log_factor))
    for strain in (3.0, 4.0):
        prior = replace(updated.bayesian.prior, sd=largest / strain)
        changed = replace(updated, bayesian=replace(updated.bayesian, prior=prior))
        places = [
            a.places[0]
            for a in alerts(paper_run, updating=updating_numbers(replace(paper_run.beam, updated=changed)))
            if a.kind == "beam"
        ]
        assert [at for at, _ in places] == ["updating"] * (strain > 3.5)
        assert all(f"{strain:.1f} standard deviations of the prior" in text for _, text in places)


def test_flags_of_modes_that_were_only_also_excited_come_last():
    recording = runs.recording(2, number=3, frequency_hz=26.84, seconds=1.5)
    modes = tuple(
        mode if mode.target else replace(mode, flags=("HARMONIC",), severities=(("HARMONIC", "WRONG"),))
        for mode in recording.identification.modes
    )
    found = replace(recording.identification, modes=modes)
    (alert,) = alerts(runs.run_result([replace(recording, identification=found)]))
    assert (alert.kind, alert.places) == ("other", (("r1", "recording_3, Mode 1: HARMONIC"),))
