"""What the studio says to do next, which views are done, how messages rank, and the modes of a run."""

import json
from dataclasses import replace

import pytest
from kit import runs

from modalcam.apps.studio import Stand, done_views, next_step, ranked, run_results
from modalcam.tables import summary

# One step after the other, each with the first words of what follows it.
STEPS = (
    (Stand(is_read=False), "wait until"),
    (Stand(recordings=0), "include a recording"),
    (Stand(without_rate=tuple("abcde")), "give the recorded rate of a, b, c and 2 more"),
    (Stand(problem="a: set points_px"), "correct the options, under Markers: a: set points_px"),
    (Stand(), "look at the markers"),
    (Stand(markers_seen=True), "run, under"),
    (Stand(is_tracked=True), "run, under"),
    (Stand(is_running=True, without_rate=("a",)), "wait for the run"),
    (Stand(is_reported=True, failures=2), "read why 2 of the recordings failed"),
    (Stand(is_reported=True), "read the report"),
)


@pytest.mark.parametrize(("stand", "words"), STEPS)
def test_one_step_follows_the_other(stand, words):
    assert next_step(stand).startswith(f"Next: {words}")


def test_views_are_ticked_when_nothing_is_left_to_do_in_them():
    finished = Stand(has_beam=True, is_tracked=True, is_reported=True, decay_seen=True)
    assert not next_step(finished).startswith("Next")
    assert done_views(finished) == {"Recordings", "Markers", "Beam", "Test track", "Run and report", "Decay"}
    assert done_views(Stand(without_rate=("a",))) == set()
    assert done_views(replace(finished, is_reported=False)).isdisjoint({"Run and report", "Decay"})
    assert "Run and report" not in done_views(replace(finished, failures=1))


def test_what_prevents_a_result_is_said_first():
    messages = ["note: no beam", "WARNING a: playback rate", "up to date", "FAILED b: no markers"]
    said = [(rank.word, text) for rank, text in ranked(messages)]
    assert said == [
        ("Blocking", "b: no markers"),
        ("Doubtful", "a: playback rate"),
        ("Note", "no beam"),
        ("Note", "up to date"),
    ]


def test_modes_and_failures_are_those_of_the_summary(tmp_path):
    path = tmp_path / "summary.json"
    good, bad = runs.recording(0, seconds=1.0), replace(runs.recording(1, seconds=1.0), file="b.avi")
    found = summary(runs.run_result((good, bad)))
    found["recordings"][1] |= {"modes": [], "failed_modes": [{"target": True, "reason": "it is driven"}]}
    path.write_text(json.dumps(found))
    results = run_results(path)
    target = good.identification.target
    ((name, _, frequency, *_, flags),) = results.rows
    assert name == good.name
    assert float(frequency.split(" ± ")[0]) == pytest.approx(target.frequency_hz, abs=target.frequency_sd_hz)
    assert flags == ", ".join(target.flags)
    assert results.failures == (("b.avi", "it is driven"),)
    path.write_text('{"recordings": [{}]}')
    assert "summary.json of the run cannot be read" in run_results(path).reason
