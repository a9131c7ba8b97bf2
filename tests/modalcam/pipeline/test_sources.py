"""Recordings of the same content are named: they are one measurement."""

from modalcam.pipeline import RecordingResult, duplicates


def test_recordings_of_the_same_content_are_named_once():
    recordings = [
        RecordingResult(name, f"{name}.avi", sha256, None)
        for name, sha256 in (("a", "1"), ("b", "2"), ("c", "1"), ("d", ""), ("e", ""), ("f", "1"))
    ]
    told = "a.avi, c.avi and f.avi have the same content: they are one measurement, not 3."
    assert duplicates(recordings) == (told,)
