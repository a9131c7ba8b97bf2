"""The shape of a mode beside theory: the criterion in the caption is that of the curve which is drawn."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs

from modalcam.report.figures import RecordingSubject, shape_of


def test_the_assurance_criterion_is_that_of_the_drawn_curve():
    """That of the mode is with the configured beam; the curve may be of the updated one."""
    recording = runs.recording(0, number=2)
    found = recording.identification
    modes = tuple(replace(mode, mac=0.342) for mode in found.modes)
    recording = replace(recording, identification=replace(found, modes=modes))
    shown = shape_of(RecordingSubject(recording, runs.beam_theory()))
    # Linear interpolation of 121 points of mode 2 errs by under 1e-3 of its largest value.
    at_markers = np.interp(shown.position_mm, *shown.curve)
    expected = abs(np.vdot(shown.shape, at_markers)) ** 2
    expected /= np.vdot(shown.shape, shown.shape).real * np.vdot(at_markers, at_markers).real
    assert shown.mac == pytest.approx(expected, abs=1e-3)
    assert shown.mac > 0.99
    assert shape_of(RecordingSubject(recording)).mac != shown.mac, "unknown without theory"
