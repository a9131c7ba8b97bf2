"""Flags that matter are listed before the results, one line each; information stays in the tables."""

from dataclasses import replace

from support import report_runs as runs
from support.html_page import Page

from modalcam.report.sections.alerts import alerts


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


def test_information_alone_leaves_the_result_good():
    result = with_severities(("LOW_SNR", "INFORMATION"))
    assert not {"wrong", "interval"} & set(alerts(result))


def test_the_page_shows_the_curve_and_the_flags(build):
    result = with_severities(("AMPLITUDE_DEPENDENT", "INTERVAL"))
    words = Page(build(result)).words
    assert "Intervals that are wider for a reason" in words
    assert "most probable law: saturating" in words
    assert "they leave 33 times the noise power at the mode, the curve 1.1 times" in words
