"""A scene of moving markers and the beam behind them: its frames as a camera records them, and the true centres."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.render.camera import Camera, Motion, Poses
from sim.render.kernels import add_marker, add_strip, order_for, unit_rule
from sim.render.markers import Marker, MarkerTable, Texture
from sim.render.strip import BareStrip, StripImage
from tracker import FloatArray, checked


@dataclass(frozen=True)
class Tuning:
    """Memory."""

    #: [frames] frames whose poses are evaluated at a time
    #: convention: Enough for an efficient call, little memory; results do not depend on it.
    block: int = 64


TUNING = Tuning()


@dataclass(frozen=True, kw_only=True)
class Strip:
    """The beam behind markers: a polyline of constant width and brightness, hidden where a marker covers it.

    Cheap; where the beam is to be measured itself, use `BareStrip`.

    Each segment is an exact blurred rectangle. At a joint two segments overlap or leave a gap of ``width^2 / 8`` times
    the angle between them, and a chord deviates from its arc by ``curvature length^2 / 8``: choose segments short
    enough for both to be well below a pixel.

    Attributes
    ----------
    width_mm, gray : float
    motion : Motion
        Of the points on the centreline, in order; the angles are not used.
    """

    width_mm: float
    gray: float
    motion: Motion

    def __post_init__(self) -> None:
        checked("width_mm of a strip", self.width_mm, positive=True)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Moving markers, point i of the motion carrying ``markers[i]``; optionally the beam and a pattern behind them.

    The pattern, a `backdrop` at rest, is added to the camera's background. It needs a bare strip, or nothing else: the
    image of a marker is that in front of an even background.
    """

    markers: tuple[Marker, ...]
    motion: Motion
    strip: Strip | BareStrip | None = None
    backdrop: Texture | None = None

    def __post_init__(self) -> None:
        if self.backdrop is not None and (self.markers or isinstance(self.strip, Strip)):
            msg = "a backdrop is rendered behind a bare strip without markers only; leave out the backdrop"
            raise ValueError(msg)


def render_frames(
    scene: Scene, camera: Camera, frame_times_s: FloatArray, rng: np.random.Generator
) -> Iterator[NDArray[Any]]:
    """Film a scene: integrated over pixel and exposure, through the lens, with noise, rounded and clipped.

    Parameters
    ----------
    frame_times_s : array, shape (n,)
        Middles of the exposures.
    rng : numpy.random.Generator
        For noise and flicker; consumed frame by frame, so the first frames of a longer recording are the same.

    Yields
    ------
    array, shape (height_px, width_px)
        uint8 for 8 bit, uint16 above; new for each frame.

    Raises
    ------
    ValueError
        If two markers overlap in a frame, the motion is unknown or not finite at a time, the path during an exposure is
        too long to be integrated, or a bare strip is bent to a radius below its width.

    Notes
    -----
    Noise is normal with variance ``read_noise_sd^2 + noise_gain I``, I the mean count, which holds above about ten
    electrons. Flicker multiplies a whole frame before the noise.
    """
    return expose(render_ideal(scene, camera, frame_times_s), camera, rng)


def expose(means: Iterable[FloatArray], camera: Camera, rng: np.random.Generator) -> Iterator[NDArray[Any]]:
    """Frames from their mean counts (`render_ideal`): flicker and noise added, rounded and clipped.

    The same means with another generator give another recording of the same motion.
    """
    for image in means:
        brightness = 1.0 + camera.flicker_sd * rng.standard_normal()
        signal = image * max(brightness, 0.0)
        variance = camera.read_noise_sd**2 + camera.noise_gain * np.maximum(signal, 0.0)
        signal += np.sqrt(variance) * rng.standard_normal(signal.shape, dtype=np.float32)
        yield np.clip(np.rint(signal), 0, camera.max_count).astype(camera.dtype)


def render_ideal(scene: Scene, camera: Camera, frame_times_s: FloatArray) -> Iterator[FloatArray]:
    """Yield the mean counts of each pixel: no noise, no flicker, no rounding, no clipping.

    The integrals over a pixel and over the exposure are each within 4e-6 of the contrast (0.001 gray of 8 bit)
    for an edge; the path of a marker during an exposure is measured through its start, middle and end, so a
    vibration of more than half a cycle per exposure is not resolved. Uneven light is part of the means, taken as
    constant over a pixel. Parameters and errors as in `render_frames`.
    """
    light = camera.light()
    times = np.asarray(frame_times_s, dtype=np.float64)
    parts = _Parts.of(scene, camera)
    for start in range(0, times.size, TUNING.block):
        block = times[start : start + TUNING.block]
        orders = _exposure_orders(scene, camera, block)
        offsets = np.concatenate([[0], np.cumsum(orders)])
        nodes = [time + camera.exposure_s * unit_rule(n)[0] for time, n in zip(block, orders, strict=True)]
        track = _Track.of(scene, camera, np.concatenate(nodes))
        for low, high in pairwise(offsets):
            yield _draw(scene, camera, parts, track, int(low), int(high)) * light


def true_centres_px(scene: Scene, camera: Camera, frame_times_s: FloatArray) -> FloatArray:
    """Centres of the markers at the middle of each exposure.

    The centroid of a blurred image is the mean over the exposure, which differs from the middle by
    ``acceleration exposure^2 / 24``.

    Returns
    -------
    array, shape (n, m, 2)
        x, y in px.
    """
    poses = scene.motion(np.asarray(frame_times_s, dtype=np.float64))
    return np.stack(camera.to_px(poses.x_mm, poses.y_mm), axis=-1)


def true_line_px(scene: Scene, camera: Camera, frame_times_s: FloatArray, arc_mm: FloatArray) -> FloatArray:
    """Material points of a bare strip's centreline, at distances `arc_mm`, (k,), along it, in each exposure's middle.

    Returns
    -------
    array, shape (n, k, 2)
        x, y in px.

    Raises
    ------
    ValueError
        If the scene has no bare strip, or a point lies beyond it.
    """
    if not isinstance(scene.strip, BareStrip):
        msg = "the scene has no bare strip, so there is no line; its markers have centres (true_centres_px)"
        raise ValueError(msg)  # noqa: TRY004 - the scene is wrong, not the type of an argument
    points = scene.strip.points_mm(np.asarray(frame_times_s, dtype=np.float64), arc_mm)
    return np.stack(camera.to_px(points[..., 0], points[..., 1]), axis=-1)


@dataclass(frozen=True)
class _Parts:
    """What is the same in all frames: images of the markers, the drawer of a bare strip, and the background."""

    tables: list[MarkerTable]
    strip: StripImage | None
    behind: FloatArray

    @classmethod
    def of(cls, scene: Scene, camera: Camera) -> _Parts:
        tables = [
            p.table(
                mm_per_px=camera.mm_per_px, lens_blur_px=camera.lens_blur_px, background=camera.background
            )
            for p in scene.markers
        ]
        bare = scene.strip if isinstance(scene.strip, BareStrip) else None
        strip = None if bare is None else StripImage(bare, camera, scene.backdrop)
        behind: FloatArray = np.full((camera.height_px, camera.width_px), float(camera.background))
        if scene.backdrop is not None:
            behind += scene.backdrop.on_grid(
                *camera.to_mm(np.arange(float(camera.width_px)), np.arange(float(camera.height_px))),
                box_mm=camera.mm_per_px,
                blur_mm=camera.lens_blur_px * camera.mm_per_px,
            )
        return cls(tables, strip, behind)


@dataclass(frozen=True)
class _Track:
    """Markers (k, m) and centreline (k, p, 2) in px, and the points of the strip, at k instants."""

    x_px: FloatArray
    y_px: FloatArray
    angle_rad: FloatArray
    line_px: FloatArray
    points: Poses | None

    @classmethod
    def of(cls, scene: Scene, camera: Camera, times_s: FloatArray) -> _Track:
        poses = _checked(scene.motion(times_s), times_s)
        if poses.x_mm.shape[1] != len(scene.markers):
            msg = f"the scene has {len(scene.markers)} markers, but its motion {poses.x_mm.shape[1]} points"
            raise ValueError(msg)
        x_px, y_px = camera.to_px(poses.x_mm, poses.y_mm)
        line, points = np.zeros((times_s.size, 0, 2)), None
        if scene.strip is not None:
            points = _checked(scene.strip.motion(times_s), times_s)
            line = np.stack(camera.to_px(points.x_mm, points.y_mm), axis=-1)
        return cls(x_px, y_px, poses.angle_rad, line, points)


def _checked(poses: Poses, times_s: FloatArray) -> Poses:
    finite = np.isfinite(poses.x_mm) & np.isfinite(poses.y_mm) & np.isfinite(poses.angle_rad)
    bad = ~np.all(finite, axis=1)
    if np.any(bad):
        msg = f"the motion is not finite at {times_s[bad][0]:g} s"
        raise ValueError(msg)
    return poses


def _exposure_orders(scene: Scene, camera: Camera, times_s: FloatArray) -> list[int]:
    """Number of instants that integrate each frame's exposure, from the longest path in it."""
    if camera.exposure_s == 0.0:
        return [1] * times_s.size
    half = 0.5 * camera.exposure_s
    track = _Track.of(scene, camera, np.concatenate([times_s - half, times_s, times_s + half]))
    shape = (3, times_s.size, -1)
    reach = np.array([p.half_extent_mm / camera.mm_per_px for p in scene.markers])
    steps = np.hypot(np.diff(track.x_px.reshape(shape), axis=0), np.diff(track.y_px.reshape(shape), axis=0))
    # a corner of the marker moves further than its centre
    steps = steps + np.sqrt(2.0) * reach * np.abs(np.diff(track.angle_rad.reshape(shape), axis=0))
    line = np.diff(track.line_px.reshape(3, times_s.size, -1, 2), axis=0)
    paths = np.concatenate([steps, np.hypot(line[..., 0], line[..., 1])], axis=-1).sum(axis=0)
    longest = paths.max(axis=1, initial=0.0)
    return [order_for(float(path) / camera.lens_blur_px) for path in longest]


def _draw(scene: Scene, camera: Camera, parts: _Parts, track: _Track, low: int, high: int) -> FloatArray:
    image = parts.behind.copy()
    nodes, weights = unit_rule(order_for(1.0 / camera.lens_blur_px))
    shares = unit_rule(high - low)[1]
    reach = np.array([p.half_extent_mm / camera.mm_per_px for p in scene.markers])
    for k, share in enumerate(shares, low):
        x, y, angle = track.x_px[k], track.y_px[k], track.angle_rad[k]
        _refuse_overlap(x, y, reach)
        covers = np.column_stack([x, y, reach])
        for i, table in enumerate(parts.tables):
            add_marker(image, table.values, table.step_px, x[i], y[i], angle[i], share, nodes, weights)
        if isinstance(scene.strip, Strip):
            add_strip(
                image,
                np.ascontiguousarray(track.line_px[k]),
                covers,
                0.5 * scene.strip.width_mm / camera.mm_per_px,
                float(share * (scene.strip.gray - camera.background)),
                camera.lens_blur_px,
                nodes,
                weights,
            )
        if parts.strip is not None and track.points is not None:
            parts.strip.add(image, track.points.at(slice(k, k + 1)), covers, float(share))
    return image


def _refuse_overlap(x: FloatArray, y: FloatArray, reach: FloatArray) -> None:
    distance = np.hypot(x[:, None] - x[None, :], y[:, None] - y[None, :])
    overlap = np.triu(distance < reach[:, None] + reach[None, :], k=1)
    if np.any(overlap):
        i, j = np.argwhere(overlap)[0]
        msg = f"markers {i} and {j} overlap: their centres are {distance[i, j]:.1f} px apart"
        raise ValueError(msg)
