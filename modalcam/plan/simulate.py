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
from modalcam.filming import PLAYBACK_FPS
from modalcam.plan.request import PlanRequest, decay_length_s
from sim.ancf import AncfBeam
from sim.damping import GenericDamping
from sim.filming import Film, Optics, Take, film_take
from sim.modes import beam_modes
from sim.render.prints import DotPrint
from sim.render.video import write_video
from tracker.motion import displacement_series
from tracker.series import MarkerTracks
from tracker.settings import TrackerSettings
from tracker.track import track_recording

_MODES_FILMED = 8
# Steady shaking before the stop, in cycles and seconds.
_SHAKE_CYCLES, _SHAKE_S = 8.0, 0.1


@dataclass(frozen=True)
class Trial:
    """One rendered recording: what was identified and what was put in; `problem` says why nothing was."""

    mode: int
    frequency_hz: float
    damping_ratio: float
    frequency_sd_hz: float
    damping_sd: float
    problem: str = ""


def try_out(request: PlanRequest, index: int, seed: tuple[int, ...]) -> Trial:
    """Film one planned mode once, follow the markers and identify it, as `modalcam run` would.

    Parameters
    ----------
    index : int
        Of the planned mode in the request.
    seed : tuple of int
        Of the camera's noise and the sampler.
    """
    mode = request.modes[index]
    with tempfile.TemporaryDirectory(prefix="modalcam-plan-") as folder:
        path = Path(folder) / "take.mkv"
        problem = _film(request, index, seed, path)
        if problem:
            return _failed(mode.number, problem)
        tracks = track_recording(path, "take", _tracker_settings(request))
    if not isinstance(tracks, MarkerTracks):
        return _failed(mode.number, tracks.reason)
    ways = beam_modes(AncfBeam(request.beam), _MODES_FILMED)
    settings = IdentifySettings(
        target_number=mode.number,
        expected_frequencies_hz=tuple(float(f) for f in ways.frequency_hz),
        expected_shapes=ways.transverse_at(1e-3 * np.array(request.positions_mm)),
        seed=seed[0],
        seed_key=seed[1:],
    )
    found = identify(displacement_series(tracks), settings)
    target = found.target if isinstance(found, Identification) else None
    if not isinstance(target, IdentifiedMode):
        reason = found.reason if isinstance(found, FailedIdentification) else "the mode was not identified"
        return _failed(mode.number, reason)
    return Trial(
        mode.number,
        target.frequency_hz,
        target.damping_ratio,
        target.frequency_sd_hz,
        target.damping_ratio_sd,
    )


def _film(request: PlanRequest, index: int, seed: tuple[int, ...], path: Path) -> str:
    """Write the recording; a reason where it cannot be simulated."""
    mode, camera = request.modes[index], request.camera
    frequency = float(beam_modes(AncfBeam(request.beam), mode.number).frequency_hz[-1])
    film = film_take(
        request.beam,
        GenericDamping((mode.damping_ratio,) * mode.number),
        Take(
            mode_number=mode.number,
            tip_amplitude_m=1e-3 * mode.tip_amplitude_mm,
            shake_s=max(_SHAKE_S, _SHAKE_CYCLES / frequency),
            decay_s=decay_length_s(mode, frequency),
        ),
        Optics(
            fps=Fraction(request.fps),
            mm_per_px=camera.mm_per_px,
            exposure_s=camera.exposure_s,
            lens_blur_px=camera.lens_blur_px,
            read_noise_sd=camera.read_noise_sd,
            noise_gain=camera.noise_gain,
            background=camera.background,
            bit_depth=camera.bit_depth,
        ),
        prints=request.prints,
        positions_m=1e-3 * np.array(request.positions_mm),
        rng=np.random.default_rng(seed),
        mode_count=max(_MODES_FILMED, mode.number + 1),
    )
    if not isinstance(film, Film):
        return f"the simulation stopped at {film.time_s:.6g} s: {film.reason}"
    write_video(path, film.frames, fps_container=PLAYBACK_FPS, codec="ffv1")
    return ""


def _tracker_settings(request: PlanRequest) -> TrackerSettings:
    dots = all(isinstance(p, DotPrint) for p in request.prints)
    return TrackerSettings(
        fps=Fraction(request.fps),
        mm_per_px=request.camera.mm_per_px,
        exposure_s=request.camera.exposure_s or None,
        kind="blob" if dots else "aruco",
        positions_mm=request.positions_mm,
    )


def _failed(mode: int, reason: str) -> Trial:
    nan = float("nan")
    return Trial(mode, nan, nan, nan, nan, reason)
