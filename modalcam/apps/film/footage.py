"""A few frames of a recording's decay, kept for comparison with the same frames of the simulated beam."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode
from tracker import Failure, FloatArray, GrayImage, MarkerTracks
from tracker.video import UnreadableVideoError, open_recording


@dataclass(frozen=True, eq=False)
class KeptFrames:
    """Frames of a recording, cropped to its markers and reduced by averaging whole blocks of pixels.

    `frame`, shape (n,), are rows of the tracks, evenly spaced. In `images`, shape (n, height, width), 0 is black, 255
    the camera's white. A block has `shrink` pixels of the recording at each side, in which the corner of the crop is at
    `left_px`, `top_px`. `noise_sd` is that of a pixel of the recording, in these gray levels; `period_s` is that of the
    mode that is shown.
    """

    recording: str
    frame: NDArray[np.int64]
    time_s: FloatArray
    images: NDArray[np.uint8]
    shrink: int
    left_px: int
    top_px: int
    noise_sd: float
    period_s: float


@dataclass(frozen=True, eq=False)
class SimulatedFootage:
    """Frames of the simulated beam at the times of the kept frames of a recording.

    `images`, shape (n, height, width), have the crop, scale and gray levels of the kept frames. `largest_mm` is the
    largest simulated displacement of a marker from rest in them, `difference_mm` the rms distance between measured and
    simulated centres, NaN if none was measured; `most_moving_px` is the rest position, x and y in these images, of the
    marker with the largest displacement.
    """

    recording: str
    time_s: FloatArray
    images: NDArray[np.uint8]
    mm_per_px: float
    period_s: float
    largest_mm: float
    difference_mm: float
    most_moving_px: tuple[float, float]


# Enough frames to show two periods, and pixels of each frame.
_MOST_FRAMES = 28
_PER_PERIOD = 14
_MOST_PIXELS = 60_000
# Margin around the markers, in marker sizes.
_MARGIN = 1.2
_DEFAULT_MARKER_PX = 20.0


def read_kept_frames(
    path: Path, tracks: MarkerTracks, found: Identification, size_mm: float | None
) -> KeptFrames | Failure:
    """Frames of at least two periods around the time at which the recording's mode has decayed to one half.

    The recording is read up to the last of these frames; a damaged frame ends the selection.
    """
    mode = found.target or max(found.fitted_modes, key=lambda m: m.amplitude, default=None)
    if mode is None:
        return Failure("no mode was identified")
    last = int(np.flatnonzero(found.decay_rows)[-1])
    rows = chosen_rows(tracks.time_s[: last + 1], found.onset.fit_from_s, mode)
    if rows.size < 4:
        return Failure("the decay has too few frames to show")
    marker_px = _DEFAULT_MARKER_PX
    if size_mm is not None and tracks.scale is not None:
        marker_px = size_mm / tracks.scale.mm_per_px
    left, top, right, bottom = _crop(tracks, _MARGIN * marker_px)
    shrink = max(1, math.ceil(math.sqrt((right - left) * (bottom - top) / _MOST_PIXELS)))
    right, bottom = right - (right - left) % shrink, bottom - (bottom - top) % shrink
    if right <= left or bottom <= top:
        return Failure("no marker was detected in any frame")
    try:
        with closing(open_recording(path)) as source:
            white = float(source.info.white_level)
            selected = list(_selected((frame.image for frame in source.frames()), rows))
    except UnreadableVideoError as error:
        return Failure(str(error))
    rows = rows[: len(selected)]
    if rows.size < 4:
        return Failure("the frames after the onset are damaged")
    images = np.stack([image[top:bottom, left:right] for image in selected]) * (255.0 / white)
    return KeptFrames(
        recording=tracks.recording,
        frame=rows,
        time_s=tracks.time_s[rows],
        images=to_gray(reduced(images, shrink)),
        shrink=shrink,
        left_px=left,
        top_px=top,
        noise_sd=_noise(images),
        period_s=1.0 / mode.frequency_hz,
    )


def chosen_rows(time_s: FloatArray, fit_from_s: float, mode: IdentifiedMode) -> NDArray[np.int64]:
    """Evenly spaced rows over whole periods, from where half of the amplitude is left if the record is long enough."""
    step_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else math.inf
    per_period = 1.0 / (mode.frequency_hz * step_s)
    every = max(1, round(per_period / _PER_PERIOD))
    periods = max(1, round(_MOST_FRAMES * every / per_period - 0.5))
    count = min(_MOST_FRAMES, round(periods * per_period / every))
    half_s = math.log(2.0) / (2.0 * math.pi * mode.frequency_hz * max(mode.damping_ratio, 1e-6))
    first = int(np.searchsorted(time_s, fit_from_s + half_s))
    # No exposure, at most a step long, begins before the fitted motion does.
    earliest = int(np.searchsorted(time_s, fit_from_s + 0.5 * step_s))
    first = max(earliest, min(first, time_s.size - (count - 1) * every - 1))
    rows = first + every * np.arange(count, dtype=np.int64)
    return rows[rows < time_s.size]


def reduced(images: FloatArray, shrink: int) -> FloatArray:
    """Means over blocks of ``shrink x shrink`` pixels; the sides of (n, height, width) must be multiples of it."""
    n, height, width = images.shape
    blocks = images.reshape(n, height // shrink, shrink, width // shrink, shrink)
    return np.asarray(blocks.mean(axis=(2, 4)))


def to_gray(images: FloatArray) -> NDArray[np.uint8]:
    """Gray levels rounded and clipped to 8 bit."""
    return np.clip(np.rint(images), 0, 255).astype(np.uint8)


def _crop(tracks: MarkerTracks, margin: float) -> tuple[int, int, int, int]:
    x, y = tracks.x_px[np.isfinite(tracks.x_px)], tracks.y_px[np.isfinite(tracks.y_px)]
    if not x.size:
        return 0, 0, 0, 0
    return (
        max(0, math.floor(x.min() - margin)),
        max(0, math.floor(y.min() - margin)),
        min(tracks.decode.width_px, math.ceil(x.max() + margin) + 1),
        min(tracks.decode.height_px, math.ceil(y.max() + margin) + 1),
    )


def _selected(images: Iterator[GrayImage | None], rows: NDArray[np.int64]) -> Iterator[FloatArray]:
    """Images of `rows`, up to the first one that is damaged or missing."""
    remaining = rows.tolist()
    for number, image in enumerate(images):
        if not remaining or (number == remaining[0] and image is None):
            return
        if number == remaining[0]:
            yield np.asarray(image, dtype=np.float64)
            del remaining[0]


def _noise(images: FloatArray) -> float:
    """Standard deviation of a pixel over time, where nothing moves: in most of the image."""
    dof = images.shape[0] - 1
    # Median of chi-square over its degrees of freedom (Wilson and Hilferty 1931).
    variance = float(np.median(images.var(axis=0, ddof=1))) / (1.0 - 2.0 / (9.0 * dof)) ** 3
    # Without the share of rounding, which the rendered frames have again.
    return math.sqrt(max(0.0, variance - 1.0 / 12.0))
