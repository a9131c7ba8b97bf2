"""Simulated videos of the paper's beam oscillating in air, tracked and identified."""

from fractions import Fraction

import numpy as np
from support.sampling import QUICK

from modal_id import IdentifySettings, identify
from sim import MEASURED_DAMPING_RATIO, sample_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping, StillAir, WithAirDrag
from sim.render import DotMarker, Optics, RecordingPlan, stage_recording, write_video
from tracker import TrackerSettings, displacement_series, track

POSITIONS_MM = np.array([2.0, 90.0, 190.0, 290.0, 390.0, 490.0])
DAMPING = GenericDamping(MEASURED_DAMPING_RATIO, 0.003)
DOT_MM, MM_PER_PX, EXPOSURE_S = 12.0, 2.0, 5e-4
# The base has come to rest after a tenth of a period.
STOPPED_S = 0.06


def identified_film(path, *, drag_coefficient, tip_m, fps, decay_s, seed):
    """A rendered decay of mode 1 with tip amplitude `tip_m` (linear theory), tracked and identified."""
    properties = sample_beam()
    dot = DotMarker(diameter_mm=DOT_MM, foreground=35.0, background=190.0, quiet_zone_mm=3.0)
    film = stage_recording(
        properties,
        WithAirDrag(DAMPING, StillAir(1.204, drag_coefficient)),
        RecordingPlan(mode_number=1, tip_amplitude_m=tip_m, shake_s=0.3, decay_s=decay_s),
        Optics(
            fps=Fraction(fps), mm_per_px=MM_PER_PX, exposure_s=EXPOSURE_S, background=190.0, noise_gain=0.04
        ),
        markers=(dot,) * POSITIONS_MM.size,
        positions_m=1e-3 * POSITIONS_MM,
    )
    assert film, getattr(film, "reason", "")
    write_video(path, film.frames(np.random.default_rng(seed)), fps_container=Fraction(30), codec="ffv1")
    settings = TrackerSettings(
        fps=Fraction(fps),
        mm_per_px=MM_PER_PX,
        exposure_s=EXPOSURE_S,
        kind="blob",
        size_mm=DOT_MM,
        positions_mm=tuple(POSITIONS_MM),
    )
    tracks = track(path, settings, recording=path.name)
    modes = beam_modes(AncfBeam(properties), 8)
    found = identify(
        displacement_series(tracks),
        IdentifySettings(
            mode=1,
            expected_frequencies_hz=tuple(modes.frequency_hz),
            expected_shapes=modes.transverse_at(1e-3 * POSITIONS_MM),
            onset_s=film.onset_s + STOPPED_S,
            sampler=QUICK,
        ),
    )
    assert found, getattr(found, "reason", "")
    return found
