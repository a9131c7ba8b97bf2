"""The simulated beam filmed as the recording was: same frames, same places, scale, exposure, light and noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification
from modalcam.config.schema import RecordingConfig
from modalcam.video.kept_frames import reduced, to_gray
from modalcam.video.printed_markers import printed_markers
from modalcam.video.results import KeptFrames, NoSimulatedFootage, SimulatedFootage
from sim.beam.properties import BeamProperties
from sim.damping import DampingModel
from sim.dynamics.trajectory import FailedSimulation
from sim.render.camera import Camera
from sim.render.frames import render_frames
from sim.render.markers import Marker
from sim.render.motion import SampledMotion
from sim.render.scene import Scene, Strip
from sim.render.simulated_motion import SimulatedMotion, simulated_motion
from tracker.arrays import FloatArray
from tracker.markers.registry import MARKER_KINDS
from tracker.results import MarkerTracks

_STRIP_POINTS = 81
_LENS_BLUR_PX = 0.6
# Of the background's gray, as the films of `modalcam demo` have it.
_STRIP_SHARE = 0.4


@dataclass(frozen=True)
class SimulatedScene:
    """A simulated beam before the camera of a recording.

    Attributes
    ----------
    scene : Scene
    camera : Camera
        Of the crop, in pixels of the recording.
    centres_px : array, shape (n, m, 2)
        Simulated centres at the times asked for, in pixels of the recording.
    rest_px : array, shape (m, 2)
    """

    scene: Scene
    camera: Camera
    centres_px: FloatArray
    rest_px: FloatArray

    def frames(self, time_s: FloatArray, rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
        """Film it at `time_s`, 8 bit."""
        return render_frames(self.scene, self.camera, time_s, rng)


def film_simulation(
    footage: KeptFrames,
    tracks: MarkerTracks,
    found: Identification,
    recording: RecordingConfig,
    properties: BeamProperties,
    damping: DampingModel,
    *,
    highest_mode: int,
    rng: np.random.Generator,
) -> SimulatedFootage | NoSimulatedFootage:
    """Simulate the decay from its fitted state and film the frames that were kept of the recording."""
    set_up = simulated_scene(
        footage, tracks, found, recording, properties, damping, highest_mode=highest_mode
    )
    if isinstance(set_up, NoSimulatedFootage):
        return set_up
    simulated = np.stack(list(set_up.frames(footage.time_s, rng))).astype(np.float64)
    assert tracks.scale is not None  # noqa: S101 - without one there is no scene
    scale = tracks.scale.mm_per_px
    moving = np.array([name not in tracks.reference for name in tracks.markers])
    seen = np.stack([tracks.x_px[footage.frame], tracks.y_px[footage.frame]], axis=-1)[:, moving]
    centres, rest = set_up.centres_px[:, moving], set_up.rest_px[moving]
    apart = np.sum((seen - centres) ** 2, axis=-1)
    known = apart[np.isfinite(apart)]
    reach = np.hypot(*np.moveaxis(centres - rest, -1, 0))
    most = int(np.argmax(reach.max(axis=0)))
    corner = np.array([footage.left_px, footage.top_px])
    closest = (rest[most] - corner + 0.5) / footage.shrink - 0.5
    return SimulatedFootage(
        recording=footage.recording,
        time_s=footage.time_s,
        images=to_gray(reduced(simulated, footage.shrink)),
        mm_per_px=scale * footage.shrink,
        period_s=footage.period_s,
        largest_mm=scale * float(reach.max()),
        difference_mm=scale * math.sqrt(float(known.mean())) if known.size else math.nan,
        most_moving_px=(float(closest[0]), float(closest[1])),
    )


def simulated_scene(
    footage: KeptFrames,
    tracks: MarkerTracks,
    found: Identification,
    recording: RecordingConfig,
    properties: BeamProperties,
    damping: DampingModel,
    *,
    highest_mode: int,
    time_s: FloatArray | None = None,
) -> SimulatedScene | NoSimulatedFootage:
    """Beam, markers and camera as the recording shows them, at the footage's times if no others are given.

    The simulated picture is turned and moved onto the recorded one by the markers' places at rest and the direction
    of the measured motion; each marker rests where it did in the recording, and moves as the simulation says.
    """
    name = footage.recording
    prints = _prints(tracks, recording, footage)
    if isinstance(prints, str):
        return NoSimulatedFootage(name, prints)
    times = footage.time_s if time_s is None else time_s
    half_exposure_s = 0.5 * (recording.exposure_s or 0.0)
    positions_m = 1e-3 * tracks.positions_mm
    motion = simulated_motion(
        properties,
        found,
        damping,
        positions_m=np.concatenate([positions_m, np.linspace(0.0, properties.length_m, _STRIP_POINTS)]),
        from_s=float(times[0]) - half_exposure_s,
        until_s=float(times[-1]) + half_exposure_s,
        highest_mode=highest_mode,
    )
    if isinstance(motion, str):
        return NoSimulatedFootage(name, motion)
    if isinstance(motion, FailedSimulation):
        return NoSimulatedFootage(name, f"the simulation stopped at {motion.time_s:.6g} s: {motion.reason}")
    return _placed(motion, prints, tracks, found, recording, properties, footage, times)


def _placed(
    motion: SimulatedMotion,
    prints: tuple[Marker, ...],
    tracks: MarkerTracks,
    found: Identification,
    recording: RecordingConfig,
    properties: BeamProperties,
    footage: KeptFrames,
    times: FloatArray,
) -> SimulatedScene:
    assert tracks.scale is not None  # noqa: S101 - `_prints` has looked
    scale, count = tracks.scale.mm_per_px, len(prints)
    # y up, as the simulation has it
    seen_mm = _rest(tracks, found, scale)
    rest_mm = 1e3 * np.stack([motion.rest_x_m, motion.rest_y_m], axis=-1)
    turn = _turn(motion.axis, found.series.direction, rest_mm[:count], seen_mm)
    shift = np.mean(seen_mm - rest_mm[:count] @ turn.T, axis=0)
    own = seen_mm - (rest_mm[:count] @ turn.T + shift)
    places = 1e3 * np.stack([motion.x_m, motion.y_m], axis=-1) @ turn.T + shift
    places[:, :count] += own
    handed = float(np.linalg.det(turn))
    spin = handed * motion.angle_rad
    spline = SampledMotion(motion.time_s, places[:, :count, 0], places[:, :count, 1], spin[:, :count])
    line = SampledMotion(motion.time_s, places[:, count:, 0], places[:, count:, 1], spin[:, count:])
    height, width = footage.images.shape[1:]
    background = float(np.median(footage.images))
    camera = Camera(
        width_px=width * footage.shrink,
        height_px=height * footage.shrink,
        mm_per_px=scale,
        origin_px=(-float(footage.left_px), -float(footage.top_px)),
        exposure_s=recording.exposure_s or 0.0,
        lens_blur_px=_LENS_BLUR_PX,
        read_noise_sd=footage.noise_sd,
        background=background,
    )
    strip = Strip(
        width_mm=max(1e3 * float(properties.thickness_m.max()), 0.8 * scale),
        gray=_STRIP_SHARE * background,
        motion=line,
    )
    at = spline(times)
    return SimulatedScene(
        scene=Scene(markers=prints, motion=spline, strip=strip),
        camera=camera,
        centres_px=np.stack([at.x_mm, -at.y_mm], axis=-1) / scale,
        rest_px=seen_mm * (1.0, -1.0) / scale,
    )


def _turn(
    axis: tuple[float, float], direction: tuple[float, float], rest_mm: FloatArray, seen_mm: FloatArray
) -> FloatArray:
    """Matrix (2, 2) that brings the simulated picture to the recorded one: motion onto motion, beam onto beam."""
    u = np.array(direction if np.all(np.isfinite(direction)) else axis)
    a = np.array(axis)
    across_u, across_a = np.array([-u[1], u[0]]), np.array([-a[1], a[0]])
    beam = (rest_mm - rest_mm.mean(axis=0)) @ across_a
    seen = (seen_mm - seen_mm.mean(axis=0)) @ across_u
    # Seen from behind or in a mirror the beam runs the other way; one marker cannot tell.
    side = -1.0 if float(beam @ seen) < 0.0 else 1.0
    return np.asarray(np.outer(u, a) + side * np.outer(across_u, across_a))


def _rest(tracks: MarkerTracks, found: Identification, scale: float) -> FloatArray:
    """Place at rest of each marker in mm, y up, shape (m, 2): the median of what the fitted vibration leaves."""
    places = scale * np.stack([tracks.x_px, -tracks.y_px], axis=-1)
    series = found.series
    if np.all(np.isfinite(series.direction)):
        vibration = np.where(found.used, found.fitted - found.baseline, np.nan)
        for k, name in enumerate(tracks.markers):
            if name in series.channels:
                own = vibration[:, series.channels.index(name)]
                if np.isfinite(own).any():
                    places[:, k] -= own[:, None] * np.array(series.direction)
    return np.asarray(np.nanmedian(places, axis=0))


def _prints(
    tracks: MarkerTracks, recording: RecordingConfig, footage: KeptFrames
) -> tuple[Marker, ...] | str:
    """Rendered marker for each tracked one, or why the recording cannot be rendered."""
    if tracks.scale is None or not np.all(np.isfinite(tracks.positions_mm)):
        return "the scale or the positions of the markers along the beam are unknown"
    if tracks.plane is not None or tracks.lens is not None or tracks.readout_s:
        return "the rendered camera views the beam straight on, without lens distortion or rolling shutter"
    if not np.all(np.any(np.isfinite(tracks.x_px) & np.isfinite(tracks.y_px), axis=0)):
        return "a marker was detected in no frame"
    artwork = MARKER_KINDS[tracks.kind].artwork if tracks.kind in MARKER_KINDS else None
    levels = (0.0, 255.0)
    if artwork is not None and recording.size_mm is not None:
        levels = _levels(tracks, footage, recording.size_mm, artwork.gray_percentiles)
    return printed_markers(
        tracks.kind,
        tracks.markers,
        size_mm=recording.size_mm,
        dictionary=recording.dictionary,
        gray_levels=levels,
    )


def _levels(
    tracks: MarkerTracks, footage: KeptFrames, size_mm: float, percentiles: tuple[float, float]
) -> tuple[float, float]:
    """Gray levels of the markers' foreground and background: percentiles of the pixels inside them."""
    assert tracks.scale is not None  # noqa: S101 - asked by the caller
    half = 0.25 * size_mm / tracks.scale.mm_per_px / footage.shrink
    inside: list[NDArray[np.uint8]] = []
    x = (tracks.x_px[footage.frame] - footage.left_px + 0.5) / footage.shrink - 0.5
    y = (tracks.y_px[footage.frame] - footage.top_px + 0.5) / footage.shrink - 0.5
    for image, xs, ys in zip(footage.images, x, y, strict=True):
        for u, v in zip(xs, ys, strict=True):
            if np.isfinite(u) and np.isfinite(v):
                rows = slice(max(0, round(v - half)), round(v + half) + 1)
                inside.append(image[rows, max(0, round(u - half)) : round(u + half) + 1].ravel())
    if not inside:
        return 0.0, 255.0
    gray = np.concatenate(inside)
    foreground, background = np.percentile(gray, percentiles)
    return float(foreground), float(background)
