"""The result of a run in Python: its recordings by name, those of the same content, and its figure."""

import pytest
from kit.runs import paper_recordings, run_result

from modalcam.pipeline import RecordingResult, duplicates


def test_recordings_are_found_by_name():
    result = run_result(paper_recordings(2))
    first, second = result.recordings
    assert result[second.name] is second
    with pytest.raises(KeyError, match=f"no recording of that name; there are {first.name}, {second.name}"):
        result["other"]


def test_the_figure_shows_each_mode_with_its_interval():
    result = run_result(paper_recordings(2))
    axes = result.plot()
    assert [line.get_label() for line in axes.lines] == [recording.name for recording in result.recordings]
    for recording, line, bars in zip(result.recordings, axes.lines, axes.collections, strict=True):
        modes = recording.identified.modes
        assert list(line.get_xdata()) == [mode.frequency_hz for mode in modes]
        assert [tuple(b[:, 1]) for b in bars.get_segments()] == [mode.damping_interval() for mode in modes]


def test_recordings_of_the_same_content_are_named_once():
    recordings = [
        RecordingResult(name, f"{name}.avi", sha256, None)
        for name, sha256 in (("a", "1"), ("b", "2"), ("c", "1"), ("d", ""), ("e", ""), ("f", "1"))
    ]
    told = "a.avi, c.avi and f.avi have the same content: they are one measurement, not 3."
    assert duplicates(recordings) == (told,)
