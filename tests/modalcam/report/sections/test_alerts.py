"""Flags that matter are listed before the results, one line each; information stays in the tables."""

from dataclasses import replace

import numpy as np
import pytest
from support import report_runs as runs
from support.html_page import Page

from modal_id.results import DrivenMotion
from modalcam.report.sections.alerts import alerts
from tracker.flags import NOT_FOUND


def with_severities(*pairs):
    """Run of one recording whose target has these (flag, severity)."""
    recording = runs.recording(0, seconds=1.5, flags=tuple(flag for flag, _ in pairs))
    found = recording.identification
    target = replace(found.target, severities=pairs)
    modes = tuple(target if mode.target else mode for mode in found.modes)
    return runs.run_result([replace(recording, identification=replace(found, modes=modes))])


def test_each_severity_has_its_place():
    result = with_severities(
        ("HARMONIC", "WRONG"), ("AMPLITUDE_DEPENDENT", "INTERVAL"), ("LOW_SNR", "INFORMATION")
    )
    found = alerts(result)
    (wrong,), (interval,) = found["wrong"], found["interval"]
    assert wrong[0] == interval[0] == "r1"
    assert wrong[1].startswith("HARMONIC: ")
    assert interval[1].startswith("AMPLITUDE_DEPENDENT: ")
    assert not any("LOW_SNR" in text for lines in found.values() for _, text in lines)


@pytest.mark.parametrize(("severity", "state"), [("INFORMATION", "good"), ("INTERVAL", "care")])
def test_information_alone_leaves_the_result_good(severity, state, build):
    result = with_severities(("LOW_SNR", severity))
    assert {"wrong", "interval"}.isdisjoint(alerts(result)) == (state == "good")
    assert f"verdict {state}" in Page(build(result)).values("class")


def test_the_page_shows_the_curve_and_the_flags(build):
    result = with_severities(("AMPLITUDE_DEPENDENT", "INTERVAL"))
    words = Page(build(result)).words
    assert "Wider intervals" in words
    assert "most probable law: saturating" in words
    assert "they leave 33 times the noise power at the mode, the curve 1.1 times" in words


def test_a_driven_motion_is_listed_with_its_frequency():
    recording = runs.recording(0, seconds=1.5)
    line = DrivenMotion(20.0, 0.001, 3.2, "px")
    found = replace(recording.identification, modes=(), driven=(line,))
    lines = alerts(runs.run_result([replace(recording, identification=found)]))["wrong"]
    assert lines == [("r1", f"DRIVEN: {recording.name}, 20.00 Hz")]


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
    found = {
        name: [text for _, text in lines if text.startswith("NOT_FOUND: ")]
        for name, lines in alerts(result).items()
    }
    assert {name for name, lines in found.items() if lines} == ({kind} if kind else set())
    if kind:
        assert f"marker {tracks.markers[0]} ({100 * share:.0f} % of its frames)" in found[kind][0]
