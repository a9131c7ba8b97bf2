"""Mode shapes in motion: their proportions, and the size that they add to the page."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs

from modalcam.report.figures import RecordingSubject
from modalcam.report.sections import AMPLITUDE, LENGTH, moving_shape


def subject(theory=None):
    return RecordingSubject(runs.recording(2), theory)


def test_points_stand_at_their_distances_and_are_proportional_to_the_measured_shape():
    own = subject()
    found, mode, _ = own.target()
    moving = moving_shape(own)
    x, y = np.array(moving.points).T
    positions_mm = found.series.positions_mm
    # Coordinates are rounded to a tenth.
    np.testing.assert_allclose(x, LENGTH * positions_mm / positions_mm.max(), atol=0.051)
    assert np.max(np.abs(y)) == pytest.approx(AMPLITUDE, abs=0.051)
    # The shape is real but for a common phase: moduli are its sizes.
    size = np.abs(mode.shape)
    np.testing.assert_allclose(np.abs(y), AMPLITUDE * size / size.max(), atol=0.3)
    assert (moving.measured, moving.theory) == ("", "")


def test_theory_is_drawn_from_the_clamp_to_the_end_and_passes_the_points():
    moving = moving_shape(subject(runs.beam_theory()))
    curve = np.array([pair.split() for pair in moving.theory[1:].split("L")], dtype=float)
    assert curve[0] == pytest.approx([0.0, 0.0], abs=0.05)
    assert curve[-1, 0] == LENGTH
    x, y = np.array(moving.points).T
    # The made-up recording has the shape of theory with errors of at most 2 %.
    np.testing.assert_allclose(np.interp(x, *curve.T), y, atol=0.04 * AMPLITUDE)


def test_many_stations_are_a_line():
    recording = runs.recording(2)
    found = recording.identification
    stations = np.linspace(0.0, 490.0, 60)
    shape = np.sin(np.pi * stations / 490.0) * np.exp(0.4j)
    mode = replace(found.target, shape=shape, shape_sd=np.full(60, 1e-3))
    names, values = tuple(f"s{k}" for k in range(60)), np.zeros((found.series.time_s.size, 60))
    found = replace(
        found,
        series=replace(found.series, channels=names, values=values, sd=values, positions_mm=stations),
        modes=(mode,),
        channels_used=np.ones(60, dtype=bool),
    )
    moving = moving_shape(RecordingSubject(replace(recording, identification=found)))
    assert moving.points == ()
    drawn = np.array([pair.split() for pair in moving.measured[1:].split("L")], dtype=float)
    np.testing.assert_allclose(
        np.abs(drawn[:, 1]), AMPLITUDE * np.sin(np.pi * drawn[:, 0] / LENGTH), atol=0.011 * AMPLITUDE
    )


def test_a_recording_without_a_mode_has_none():
    assert moving_shape(RecordingSubject(replace(runs.recording(0), identification=None))) is None
