"""Tracks, written in parts; `shapes.csv` and the curvature in `summary.json` against a uniform cantilever."""

import csv
from dataclasses import fields, replace

import numpy as np
import pytest
from kit.identified import identification
from kit.runs import beam_theory, run_result
from kit.tracks import sample_tracks
from support.memory import peak_of

from benchmarks.line_scenes import ROOTS, mode_shape
from modalcam.config import ExperimentConfig
from modalcam.pipeline import BeamResult, RecordingResult, Workspace
from modalcam.tables import SHAPE_COLUMNS, SHAPES, summary
from modalcam.tables import csv_files as tables
from sim import paper_beam


def long_tracks(frames):
    """The sample's rows over and over."""
    tracks = sample_tracks()
    rows = {f.name: getattr(tracks, f.name) for f in fields(tracks)}
    long = {
        name: np.resize(value, (frames, *value.shape[1:]))
        for name, value in rows.items()
        if isinstance(value, np.ndarray) and value.shape[0] == tracks.frame.size
    }
    return replace(tracks, **{**long, "frame": np.arange(frames)})


@pytest.mark.parametrize("frames", [12, 10, 5])
def test_parts_have_the_bytes_of_the_whole(tmp_path, monkeypatch, frames):
    monkeypatch.setattr(tables, "_FRAMES_AT_ONCE", 5)
    tracks = long_tracks(frames)
    tables.write_tracks(tmp_path / "tracks.csv", tracks)
    whole = tracks.to_dataframe().to_csv(index=False, na_rep="NaN", lineterminator="\n")
    assert (tmp_path / "tracks.csv").read_text() == whole


def test_memory_is_that_of_a_part(tmp_path, monkeypatch):
    """Of a frame, the table takes 2 kB, its positions in mm 64 bytes, which are made for all frames at once."""
    tracks = long_tracks(2_000)
    tables.write_tracks(tmp_path / "tracks.csv", sample_tracks())  # imports
    peaks = []
    for frames_at_once in (2_000, 100):
        monkeypatch.setattr(tables, "_FRAMES_AT_ONCE", frames_at_once)
        peaks.append(peak_of(lambda: tables.write_tracks(tmp_path / "tracks.csv", tracks))[0])
    assert peaks[1] < 0.25 * peaks[0], (
        f"parts of a twentieth need {peaks[1]} bytes, the whole {peaks[0]}: expected a twentieth and the positions"
    )


POSITIONS_MM = 500.0 * (np.arange(40) + 0.5) / 40


def recording(name, positions_mm, amplitude_mm):
    shape = amplitude_mm * np.exp(0.4j) * mode_shape(2, positions_mm / 500.0)
    time_s = np.arange(50) / 500.0
    found = identification([(11.4, 0.003, shape, 2)], time_s=time_s, positions_mm=positions_mm, fit_from_s=0)
    return RecordingResult(name, f"{name}.avi", "00", 2, identification=found)


def rows_of(folder, result):
    (output,) = SHAPES.outputs(Workspace(folder), result, ExperimentConfig())
    output.write(output.path)
    with (folder / "shapes.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_curvature_is_that_of_the_beam_in_si_units(tmp_path):
    recordings = [recording("line", POSITIONS_MM, 12.0), recording("dots", POSITIONS_MM[4::9], 12.0)]
    result = run_result(recordings, beam=BeamResult(paper_beam(), beam_theory()))
    rows = rows_of(tmp_path, result)
    assert list(rows[0]) == [column.name for column in SHAPE_COLUMNS]
    line, dots = ([row for row in rows if row["recording"] == name] for name in ("line", "dots"))
    assert (len(line), len(dots)) == (40, 4)
    assert {row["curvature_1_m2"] for row in dots} == {"NaN"}
    at, shape, bend, sd = (
        np.array([float(row[key]) for row in line])
        for key in ("position_mm", "shape", "curvature_1_m2", "curvature_sd_1_m2")
    )
    assert np.abs(shape).max() == 1.0
    z = ROOTS[1] * at / 500.0
    ratio = (np.cosh(ROOTS[1]) + np.cos(ROOTS[1])) / (np.sinh(ROOTS[1]) + np.sin(ROOTS[1]))
    # The second derivative of a shape of 1 at the tip, which is 2 in this form, in metres.
    true = 0.5 * (ROOTS[1] / 0.5) ** 2 * (np.cosh(z) + np.cos(z) - ratio * (np.sinh(z) + np.sin(z)))
    true *= np.sign(true @ bend) / np.abs(mode_shape(2, POSITIONS_MM / 500.0)).max()
    # Without noise, and with ends that are where they are said to be.
    assert np.all(np.abs(bend - true) < sd)
    # Without the sd of the ends, they are known to a fifth of 12.5 mm: see the table in docs/studies/lines.md.
    assert np.all(sd < 0.25 * np.abs(bend).max())
    modes = [entry["modes"][0]["curvature_at_clamp"] for entry in summary(result)["recordings"]]
    # A mode of a cantilever has the curvature (root / length)^2 at the clamp where the tip moves by 1.
    clamp = (ROOTS[1] / 0.5) ** 2 / np.abs(mode_shape(2, POSITIONS_MM / 500.0)).max()
    assert abs(abs(modes[0]["value_1_m2"]) - clamp) < 3.0 * modes[0]["sd_1_m2"]
    assert modes[0]["sd_1_m2"] < 0.25 * clamp
    assert modes[0]["value_1_m2"] * bend[0] > 0.0
    assert "too few" in modes[1]["reason"]
