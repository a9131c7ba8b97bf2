"""Figures as files: their number, their data and their bytes."""

import csv

import numpy as np
import pytest
from kit import runs

from modalcam.report import write_figures
from modalcam.report.figures import FIGURES

KEYS = ("damping", "envelope", "tracking")


@pytest.fixture
def few(monkeypatch):
    """Three kinds of figures, which hold lines, dots, error bars and bars."""
    monkeypatch.setattr("modalcam.report.figures.registry.FIGURES", {key: FIGURES[key] for key in KEYS})


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("few")
def test_each_figure_has_its_files_data_and_caption(tmp_path):
    recordings = runs.compared(runs.paper_recordings(1))
    result = runs.run_result(recordings)
    first = write_figures(result, tmp_path / "a", columns=1)
    stems = ["01_run_damping", "02_recording_1_envelope", "03_recording_1_tracking"]
    files = [f"{stem}.{ending}" for stem in stems for ending in ("svg", "pdf", "csv")]
    assert [path.name for path in first] == [*files, "captions.txt"]
    assert first[1].read_bytes()[:4] == b"%PDF"
    assert 'width="252pt"' in first[0].read_text(), "one column: 3.5 in"
    captions = first[-1].read_text("utf-8")
    assert "Figure 2 (02_recording_1_envelope): Envelope, mode_1.avi. A constant damping ratio" in captions

    mode = recordings[0].identification.target
    measured = [row for row in rows(first[2]) if row["label"] == "" and float(row["x"]) == mode.frequency_hz]
    assert any(float(row["y"]) == 100.0 * mode.damping_ratio for row in measured)
    low, high = (100.0 * value for value in mode.damping_interval())
    drawn = np.array([float(row["y"]) for row in measured])
    assert np.min(np.abs(drawn - low)) < 1e-12 * high, "the interval is in the data"
    decay = recordings[0].comparison.models[1]
    simulated = [row for row in rows(first[2]) if row["label"] == "simulated, Rayleigh damping"]
    point = (decay.frequency_hz, 100.0 * decay.damping_ratio)
    assert [(float(r["x"]), float(r["y"])) for r in simulated] == [point]
    assert {row["panel"] for row in rows(first[8])} == {"1", "2"}

    again = write_figures(result, tmp_path / "b", columns=1)
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in first], "same results, same bytes"
