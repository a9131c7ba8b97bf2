"""A plan tried out: its recordings rendered, tracked and identified, again and again."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from modal_id.identify import identify
from modal_id.results import FailedIdentification, Identification, IdentifiedMode
from modal_id.settings import IdentifySettings
from modalcam.planning.means import MODES_FILMED, MeanFrames
from modalcam.planning.request import PlanRequest
from modalcam.video.film_beam import PLAYBACK_FPS
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.render.frames import expose
from sim.render.markers import DotPrint
from sim.render.video import write_video
from tracker.displacement import displacement_series
from tracker.results import MarkerTracks
from tracker.settings import TrackerSettings
from tracker.track import track


@dataclass(frozen=True)
class Trial:
    """One rendered recording: what was identified and what was put in; `problem` says why nothing was."""

    mode: int
    frequency_hz: float
    damping_ratio: float
    frequency_sd_hz: float
    damping_sd: float
    problem: str = ""


def try_out(request: PlanRequest, index: int, means: MeanFrames, seed: tuple[int, ...]) -> Trial:
    """Record one planned mode once, follow the markers and identify it, as `modalcam run` would.

    Parameters
    ----------
    index : int
        Of the planned mode in the request.
    means : MeanFrames
        Of that mode.
    seed : tuple of int
        Of the camera's noise and the sampler.
    """
    mode = request.modes[index]
    with tempfile.TemporaryDirectory(prefix="modalcam-plan-") as folder:
        path = Path(folder) / "take.mkv"
        frames = expose(means.read(), means.camera, np.random.default_rng(seed))
        write_video(path, frames, fps_container=PLAYBACK_FPS, codec="ffv1")
        tracks = track(path, _tracker_settings(request), recording="take")
    if not isinstance(tracks, MarkerTracks):
        return failed_trial(mode.number, tracks.reason)
    ways = beam_modes(AncfBeam(request.beam), MODES_FILMED)
    settings = IdentifySettings(
        mode=mode.number,
        expected_frequencies_hz=tuple(float(f) for f in ways.frequency_hz),
        expected_shapes=ways.transverse_at(1e-3 * np.array(request.positions_mm)),
        seed=seed[0],
        seed_key=seed[1:],
    )
    found = identify(displacement_series(tracks), settings)
    target = found.target if isinstance(found, Identification) else None
    if not isinstance(target, IdentifiedMode):
        reason = found.reason if isinstance(found, FailedIdentification) else "the mode was not identified"
        return failed_trial(mode.number, reason)
    return Trial(
        mode.number,
        target.frequency_hz,
        target.damping_ratio,
        target.frequency_sd_hz,
        target.damping_ratio_sd,
    )


def _tracker_settings(request: PlanRequest) -> TrackerSettings:
    dots = all(isinstance(p, DotPrint) for p in request.prints)
    return TrackerSettings(
        fps=Fraction(request.fps),
        mm_per_px=request.camera.mm_per_px,
        exposure_s=request.camera.exposure_s or None,
        kind="blob" if dots else "aruco",
        positions_mm=request.positions_mm,
    )


def failed_trial(mode: int, reason: str) -> Trial:
    """A trial that gave nothing, and why."""
    nan = float("nan")
    return Trial(mode, nan, nan, nan, nan, reason)
