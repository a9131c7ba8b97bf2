"""The table of the tracks is written in parts."""

from dataclasses import fields, replace

import numpy as np
import pytest
from kit.tracks import sample_tracks
from support.memory import peak_of

from modalcam.tables import csv_files as tables


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
