"""The simulated beam filmed like a recording: same frames, positions, scale, exposure, gray levels and noise.

Each kind of marker that has an artwork is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id import Identification
from modalcam.apps.film.footage import KeptFrames, SimulatedFootage, reduced, to_gray
from modalcam.config import RecordingConfig
from sim.beam import BeamProperties
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation
from sim.render import (
    ArucoMarker,
    Camera,
    DotMarker,
    Marker,
    SampledMotion,
    Scene,
    SimulatedMotion,
    Strip,
    render_frames,
    simulated_motion,
)
from tracker import Failure, FloatArray, MarkerTracks
from tracker.markers import MARKER_KINDS, MarkerKind

_DEFAULT_DICTIONARY = "DICT_4X4_50"


def rendered_markers(
    recording: RecordingConfig,
    names: Sequence[str] | None = None,
    gray_levels: tuple[float, float] = (30.0, 200.0),
) -> tuple[Marker, ...] | Failure:
    """Markers of a recording, of any kind but "auto".

    Parameters
    ----------
    recording : RecordingConfig
    names : sequence of str or None
        Of the markers. Those of a code contain its number, "id7"; named otherwise, they show the codes 0, 1, ... in
        their order. None for markers that are not printed yet: one for each of `positions_mm`, and DICT_4X4_50 where
        no dictionary is given.
    gray_levels : tuple of float
        Foreground (dot, black cells) and background (white cells), in counts.
    """
    known = MARKER_KINDS.get(recording.kind)
    if known is None or known.artwork is None:
        names_of_kinds = " or ".join(repr(name) for name, k in MARKER_KINDS.items() if k.artwork is not None)
        return Failure(f"markers.kind: expected {names_of_kinds} to render markers, found {recording.kind!r}")
    if recording.size_mm is None:
        return Failure("to render markers, markers.size_mm is needed")
    planned = [f"id{k}" for k in range(len(recording.positions_mm or ()))] if names is None else names
    foreground, background = gray_levels
    if known.artwork.shape == "disc":
        return tuple(DotMarker(diameter_mm=recording.size_mm, foreground=foreground) for _ in planned)
    dictionary = recording.dictionary
    if dictionary in (None, "auto"):
        if names is not None:
            return Failure("to render ArUco markers, markers.dictionary is needed")
        dictionary = _DEFAULT_DICTIONARY
    try:
        return tuple(
            ArucoMarker(
                dictionary=str(dictionary),
                marker_id=marker_id,
                size_mm=recording.size_mm,
                foreground=foreground,
                background=background,
            )
            for marker_id in _codes(known, planned)
        )
    except ValueError as error:
        return Failure(f"the markers cannot be rendered: {error}")


def _codes(kind: MarkerKind, names: Sequence[str]) -> list[int]:
    found = [rank for name in names if (rank := kind.marker_rank(name)) is not None]
    # Positions are in order of the codes.
    return found if len(found) == len(names) and found == sorted(found) else list(range(len(names)))


_STRIP_POINTS = 81
_LENS_BLUR_PX = 0.6
# Gray level of a rendered strip relative to the background.
STRIP_SHARE = 0.4


@dataclass(frozen=True)
class SimulatedScene:
    """A simulated beam in front of the camera of a recording, which is cropped to the kept frames.

    `centres_px`, shape (n, m, 2), are the simulated marker centres at the requested times, in pixels of the recording,
    as is `rest_px`, shape (m, 2).
    """

    scene: Scene
    camera: Camera
    centres_px: FloatArray
    rest_px: FloatArray


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
) -> SimulatedFootage | Failure:
    """Simulate the decay from its fitted state and render the frames that were kept of the recording."""
    staged = simulated_scene(
        footage, tracks, found, recording, properties, damping, highest_mode=highest_mode
    )
    if isinstance(staged, Failure):
        return staged
    images = np.stack(list(render_frames(staged.scene, staged.camera, footage.time_s, rng)))
    assert tracks.scale is not None  # noqa: S101 - without one there is no scene
    scale = tracks.scale.mm_per_px
    moving = np.array([name not in (*tracks.reference, *tracks.input) for name in tracks.markers])
    measured = np.stack([tracks.x_px[footage.frame], tracks.y_px[footage.frame]], axis=-1)[:, moving]
    centres, rest = staged.centres_px[:, moving], staged.rest_px[moving]
    squares = np.sum((measured - centres) ** 2, axis=-1)
    squares = squares[np.isfinite(squares)]
    displacement = np.hypot(*np.moveaxis(centres - rest, -1, 0))
    most = rest[int(np.argmax(displacement.max(axis=0)))]
    x, y = (most - (footage.left_px, footage.top_px) + 0.5) / footage.shrink - 0.5
    return SimulatedFootage(
        recording=footage.recording,
        time_s=footage.time_s,
        images=to_gray(reduced(images.astype(np.float64), footage.shrink)),
        mm_per_px=scale * footage.shrink,
        period_s=footage.period_s,
        largest_mm=scale * float(displacement.max()),
        difference_mm=scale * math.sqrt(float(squares.mean())) if squares.size else math.nan,
        most_moving_px=(float(x), float(y)),
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
) -> SimulatedScene | Failure:
    """Beam, markers and camera as in the recording, at the times of the kept frames unless others are given.

    The simulation is rotated and shifted onto the recording by the rest positions of the markers and the direction of
    the measured motion; each marker rests where it did in the recording and moves as simulated.
    """
    markers = _markers(tracks, recording, footage)
    if isinstance(markers, Failure):
        return markers
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
    if isinstance(motion, FailedSimulation):
        return Failure(f"the simulation stopped at {motion.time_s:.6g} s: {motion.reason}")
    if isinstance(motion, Failure):
        return motion
    return _staged(motion, markers, tracks, found, recording, properties, footage, times)


def _staged(
    motion: SimulatedMotion,
    markers: tuple[Marker, ...],
    tracks: MarkerTracks,
    found: Identification,
    recording: RecordingConfig,
    properties: BeamProperties,
    footage: KeptFrames,
    times: FloatArray,
) -> SimulatedScene:
    assert tracks.scale is not None  # noqa: S101 - checked by `_markers`
    scale, count = tracks.scale.mm_per_px, len(markers)
    # y upwards, as in the simulation
    measured_mm = _rest(tracks, found, scale)
    rest_mm = 1e3 * np.stack([motion.rest_x_m, motion.rest_y_m], axis=-1)
    rotation = _rotation(motion.axis, found.series.direction, rest_mm[:count], measured_mm)
    shift = np.mean(measured_mm - rest_mm[:count] @ rotation.T, axis=0)
    positions = 1e3 * np.stack([motion.x_m, motion.y_m], axis=-1) @ rotation.T + shift
    positions[:, :count] += measured_mm - (rest_mm[:count] @ rotation.T + shift)
    angle = float(np.linalg.det(rotation)) * motion.angle_rad

    def sampled(points: slice) -> SampledMotion:
        return SampledMotion(
            motion.time_s, positions[:, points, 0], positions[:, points, 1], angle[:, points]
        )

    of_markers = sampled(slice(0, count))
    background = float(np.median(footage.images))
    camera = Camera(
        width_px=footage.images.shape[2] * footage.shrink,
        height_px=footage.images.shape[1] * footage.shrink,
        mm_per_px=scale,
        origin_px=(-float(footage.left_px), -float(footage.top_px)),
        exposure_s=recording.exposure_s or 0.0,
        lens_blur_px=_LENS_BLUR_PX,
        read_noise_sd=footage.noise_sd,
        background=background,
    )
    strip = Strip(
        width_mm=max(1e3 * float(properties.thickness_m.max()), 0.8 * scale),
        gray=STRIP_SHARE * background,
        motion=sampled(slice(count, None)),
    )
    at = of_markers(times)
    return SimulatedScene(
        scene=Scene(markers=markers, motion=of_markers, strip=strip),
        camera=camera,
        centres_px=np.stack([at.x_mm, -at.y_mm], axis=-1) / scale,
        rest_px=measured_mm * (1.0, -1.0) / scale,
    )


def _rotation(
    axis: tuple[float, float], direction: tuple[float, float], rest_mm: FloatArray, measured_mm: FloatArray
) -> FloatArray:
    """Matrix (2, 2) that aligns the simulation with the recording: motion with motion, beam with beam."""
    u = np.array(direction if np.all(np.isfinite(direction)) else axis)
    a = np.array(axis)
    across_u, across_a = np.array([-u[1], u[0]]), np.array([-a[1], a[0]])
    simulated = (rest_mm - rest_mm.mean(axis=0)) @ across_a
    measured = (measured_mm - measured_mm.mean(axis=0)) @ across_u
    # Viewed from behind or in a mirror the beam runs the other way; a single marker cannot show it.
    side = -1.0 if float(simulated @ measured) < 0.0 else 1.0
    return np.asarray(np.outer(u, a) + side * np.outer(across_u, across_a))


def _rest(tracks: MarkerTracks, found: Identification, scale: float) -> FloatArray:
    """Rest position of each marker in mm, y upwards, shape (m, 2): median position without the fitted vibration."""
    positions = scale * np.stack([tracks.x_px, -tracks.y_px], axis=-1)
    series = found.series
    if np.all(np.isfinite(series.direction)):
        vibration = np.where(found.used, found.fitted - found.baseline, np.nan)
        for k, name in enumerate(tracks.markers):
            if name in series.channels:
                own = vibration[:, series.channels.index(name)]
                if np.isfinite(own).any():
                    positions[:, k] -= own[:, None] * np.array(series.direction)
    return np.asarray(np.nanmedian(positions, axis=0))


def _markers(
    tracks: MarkerTracks, recording: RecordingConfig, footage: KeptFrames
) -> tuple[Marker, ...] | Failure:
    """Rendered marker for each tracked one, or why the recording cannot be rendered."""
    if tracks.scale is None or not np.all(np.isfinite(tracks.positions_mm)):
        return Failure("the scale or the positions of the markers along the beam are unknown")
    image_mm = tracks.scale.mm_per_px * math.hypot(tracks.decode.width_px, tracks.decode.height_px)
    if recording.size_mm is not None and recording.size_mm > image_mm:
        return Failure(
            f"size_mm = {recording.size_mm:g} is more than the {image_mm:.3g} mm that the image shows"
        )
    if tracks.plane is not None or tracks.lens is not None or tracks.readout_s:
        return Failure(
            "the rendered camera views the beam straight on, without lens distortion or rolling shutter"
        )
    if not np.all(np.any(np.isfinite(tracks.x_px) & np.isfinite(tracks.y_px), axis=0)):
        return Failure("a marker was detected in no frame")
    artwork = MARKER_KINDS[tracks.kind].artwork if tracks.kind in MARKER_KINDS else None
    if tracks.kind in MARKER_KINDS and artwork is None:
        return Failure(f"its markers are rendered, and those of kind {tracks.kind!r} have no known picture")
    levels = (0.0, 255.0)
    if artwork is not None and recording.size_mm is not None:
        radius_px = 0.25 * recording.size_mm / tracks.scale.mm_per_px
        levels = _levels(tracks, footage, radius_px, artwork.gray_percentiles)
    return rendered_markers(recording.model_copy(update={"kind": tracks.kind}), tracks.markers, levels)


def _levels(
    tracks: MarkerTracks, footage: KeptFrames, radius_px: float, percentiles: tuple[float, float]
) -> tuple[float, float]:
    """Gray levels of the markers' foreground and background: percentiles of the pixels around their centres."""
    half = radius_px / footage.shrink
    inside: list[NDArray[np.uint8]] = []
    x = (tracks.x_px[footage.frame] - footage.left_px + 0.5) / footage.shrink - 0.5
    y = (tracks.y_px[footage.frame] - footage.top_px + 0.5) / footage.shrink - 0.5
    for row, k in np.argwhere(np.isfinite(x) & np.isfinite(y)):
        u, v = x[row, k], y[row, k]
        rows = slice(max(0, round(v - half)), round(v + half) + 1)
        inside.append(footage.images[row, rows, max(0, round(u - half)) : round(u + half) + 1].ravel())
    if not inside:
        return 0.0, 255.0
    foreground, background = np.percentile(np.concatenate(inside), percentiles)
    return float(foreground), float(background)
