"""Aliases of a run: table, summary and report, which leave the identified frequency as it is."""

import re
from dataclasses import replace

import pandas as pd
import pytest
from kit.runs import PLAYBACK, recording, run_result

from modalcam.config import ExperimentConfig
from modalcam.pipeline import Workspace, aliases
from modalcam.report import build_report
from modalcam.tables import WRITERS, summary

SLOW = recording(0, frequency_hz=122.07, fps=250, flags=("ALIASED_POSSIBLE",))
FAST = recording(1, frequency_hz=127.95, fps=400)


pytestmark = pytest.mark.usefixtures("no_figures")


def written(out, *recordings):
    for output in WRITERS["aliases"].outputs(Workspace(out), run_result(recordings), ExperimentConfig()):
        output.write(output.path)
    return out / "aliases.csv"


def test_two_rates_decide_in_table_summary_and_report(tmp_path):
    result = run_result((SLOW, FAST))
    table = pd.read_csv(written(tmp_path, SLOW, FAST))
    best = table.loc[table.probability.idxmax()]
    assert set(table.recording) == {"recording_1"}, "the other recording is no alias"
    assert best.frequency_hz == pytest.approx(250.0 - 122.07, abs=0.02)
    assert best.identified_hz == pytest.approx(122.07, abs=0.02)
    assert best.shown_by == "recording_2"
    (entry,) = summary(result)["aliases"]
    assert re.match(r"127\.9\d Hz \(odds .*up to 800 Hz\), not 122\.\d+ Hz", entry["finding"])
    assert [one["probability"] for one in entry["frequencies"]] == pytest.approx(table.probability.tolist())
    page = build_report(result).replace("\u00a0", " ")  # numbers are kept in one line with their units
    assert "Frequencies above half the frame rate" in page
    assert entry["finding"] in page
    assert f"{SLOW.identified.target.frequency_hz}" in page


def test_one_rate_lists_every_alias(tmp_path):
    table = pd.read_csv(written(tmp_path, SLOW))
    assert table.frequency_hz.round(1).tolist() == [122.1, 127.9, 372.1, 377.9]
    assert table.probability.tolist() == [0.25] * 4
    assert not table.informed.any()


def test_nothing_is_said_where_nothing_is_doubtful(tmp_path):
    assert not written(tmp_path, FAST).exists()
    assert "Frequencies above half the frame rate" not in build_report(run_result((FAST,)))


def test_copies_of_a_file_and_unknown_rates_are_no_evidence():
    guessed = replace(FAST, tracks=replace(FAST.tracks, time_axis=PLAYBACK))
    copy = replace(SLOW, name="copy")
    (alone,) = aliases((SLOW, guessed))
    assert not alone.informed
    assert len(aliases((SLOW, copy, FAST))) == 1
