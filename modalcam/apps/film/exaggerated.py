"""A line re-posed, or markers drawn, in an identified mode with its motion exaggerated: frames of one cycle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import floor, log10
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode
from modalcam.apps.film.footage import to_gray
from modalcam.pipeline import replacing
from modalcam.tables import encode, write_label
from tracker import Failure, FloatArray, MarkerTracks
from tracker.markers import kind_of

FRAMES = 24
# The largest exaggerated displacement, in lengths of the line, where no factor is given.
_SHARE = 0.08
# Of a written film.
_CYCLES, _FPS = 5, Fraction(24)
# Room for its text.
_LEAST_WIDTH_PX, _LABEL_PX = 240, 26
# Half the width around the line that is moved, in px: a strip with its blur. Beside it is the background.
_REACH_PX = 6.0
_BESIDE_PX = 3.0
# The line goes on beyond the parts of its first and last station.
_END_PX = 4.0
# Of the gray levels behind drawn markers; fractional bits of OpenCV's coordinates.
_DARKENED, _SHIFT = 0.4, 4
# Room beside the largest displacement.
_MARGIN_PX = 8.0


@dataclass(frozen=True, eq=False)
class ExaggeratedFilm:
    """One cycle of a mode without its decay, as it would look at `factor` times its amplitude.

    `images` have shape (n, height, width); `largest_px` is the largest displacement shown.
    """

    images: NDArray[np.uint8]
    factor: float
    largest_px: float
    frequency_hz: float


def exaggerated_film(
    tracks: MarkerTracks, found: Identification, mode: IdentifiedMode, factor: float | None = None
) -> ExaggeratedFilm | Failure:
    """Move the line in the first frame of its recording by a mode's shape; the first frame is the largest deflection.

    Pixels near the line move with the station beside them along the direction of the displacement; what they uncover
    is interpolated across the line from the background on both sides. Amplitudes are those at the start of the fit.

    Parameters
    ----------
    tracks : MarkerTracks
        Of a line, with its first frame.
    found : Identification
        Of these tracks.
    mode : IdentifiedMode
    factor : float or None
        None chooses one of 1, 2, 5, 10, 20, ... with which the largest displacement is about 8 % of the length, and 1
        at least.
    """
    if not kind_of(tracks.kind).follows_line or tracks.first_frame is None:
        return Failure('its motion is not that of a line (kind = "line") with a first frame')
    direction, scale = _direction(found), _mm_per_px(tracks, found)
    if len(found.series.channels) != len(tracks.markers) or not np.isfinite(direction.sum() + scale):
        return Failure("the displacements are not those of all stations in the image")
    x, y = (np.nanmedian(at, axis=0) for at in (tracks.x_px, tracks.y_px))
    start = np.column_stack([tracks.x_px[0], tracks.y_px[0]])
    good = np.isfinite(mode.shape) & np.isfinite(start.sum(axis=1)) & np.isfinite(x + y)
    along = np.array([-direction[1], direction[0]])
    at = start @ along
    if np.sum(at[good][[0, -1]] * (-1, 1)) < 0.0:
        along, at = -along, -at
    if np.count_nonzero(good) < 2 or np.any(np.diff(at[good]) <= 0.0):
        return Failure("the line turns back along the direction of its displacement")
    shape = _turned(mode.shape[good] / scale)
    largest = float(np.max(np.abs(shape)))
    if factor is None:
        factor = max(1.0, _round_factor(_SHARE * float(np.ptp(at[good])) / largest))
    line = _Line(at[good], (start @ direction)[good], along, direction)
    rest = np.column_stack([x, y])[good] @ direction
    moves = [
        rest - line.across + factor * np.real(shape * np.exp(2j * np.pi * k / FRAMES)) for k in range(FRAMES)
    ]
    images = _posed(tracks.first_frame, line, moves)
    return ExaggeratedFilm(images, factor, factor * largest, mode.frequency_hz)


def marker_film(
    tracks: MarkerTracks, found: Identification, mode: IdentifiedMode, factor: float | None = None
) -> ExaggeratedFilm | Failure:
    """Draw the markers, joined by straight lines, in a mode over the first frame, which is darkened.

    Parameters and choice of the factor as in `exaggerated_film`, with the distance of the outermost markers as the
    length. Reference markers, and those without a position or a shape, are left out.
    """
    direction, scale = _direction(found), _mm_per_px(tracks, found)
    known = [k for k, name in enumerate(found.series.channels) if name in tracks.markers]
    if tracks.first_frame is None or not np.isfinite(direction.sum() + scale):
        return Failure("it has no first frame, or its displacements are not those of markers in the image")
    columns = [tracks.markers.index(found.series.channels[k]) for k in known]
    rest = np.column_stack([np.nanmedian(at[:, columns], axis=0) for at in (tracks.x_px, tracks.y_px)])
    shape = mode.shape[known] / scale
    good = np.isfinite(rest.sum(axis=1)) & np.isfinite(shape)
    if np.count_nonzero(good) < 2:
        return Failure("fewer than two of its markers have a position and a shape")
    order = np.argsort((rest @ np.array([-direction[1], direction[0]]))[good])
    rest, shape = rest[good][order], _turned(shape[good][order])
    largest = float(np.max(np.abs(shape)))
    if factor is None:
        factor = max(1.0, _round_factor(_SHARE * float(np.linalg.norm(rest[-1] - rest[0])) / largest))
    margin = np.ceil(np.abs(direction) * factor * largest + _MARGIN_PX).astype(int)
    frame = tracks.first_frame
    # Even sides, for video.
    pads = [(margin[1], margin[1] + frame.shape[0] % 2), (margin[0], margin[0] + frame.shape[1] % 2)]
    dark = np.pad(to_gray(_DARKENED * frame.astype(np.float64)), pads, mode="edge")
    images = []
    for k in range(FRAMES):
        moved = rest + margin + factor * np.real(shape * np.exp(2j * np.pi * k / FRAMES))[:, None] * direction
        points = np.rint(moved * 2**_SHIFT).astype(np.int32)
        image = cv2.polylines(
            dark.copy(), [points], isClosed=False, color=255, lineType=cv2.LINE_AA, shift=_SHIFT
        )
        for point in points:
            cv2.circle(image, point.tolist(), 4 << _SHIFT, 255, cv2.FILLED, cv2.LINE_AA, _SHIFT)
        images.append(image)
    return ExaggeratedFilm(np.stack(images).astype(np.uint8), factor, factor * largest, mode.frequency_hz)


def _direction(found: Identification) -> FloatArray:
    """Unit vector of the displacement in the image, y down."""
    return np.array([found.series.direction[0], -found.series.direction[1]])


def _mm_per_px(tracks: MarkerTracks, found: Identification) -> float:
    """Unit of the displacements in px; NaN where it is not known."""
    return 1.0 if found.series.unit == "px" else tracks.scale.mm_per_px if tracks.scale else np.nan


def _turned(shape: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """The shape at the phase at which its largest value is real: the largest deflection."""
    return np.asarray(shape * np.exp(-1j * np.angle(shape[np.argmax(np.abs(shape))])))


@dataclass(frozen=True)
class _Line:
    """Stations in the first frame: along and across the direction of displacement, and both unit vectors."""

    at: FloatArray
    across: FloatArray
    along: FloatArray
    direction: FloatArray


def _posed(frame: NDArray[np.uint8], line: _Line, moves: list[FloatArray]) -> NDArray[np.uint8]:
    """The frame, with a margin for the largest move, with the line at each of the moves."""
    reach = np.abs(line.direction) * (max(float(np.max(np.abs(m))) for m in moves) + _MARGIN_PX)
    corner = np.ceil(reach).astype(int)
    columns, rows = corner.tolist()
    # Even sides, for video.
    pad = ((rows, rows + frame.shape[0] % 2), (columns, columns + frame.shape[1] % 2))
    large = np.pad(frame, pad, mode="edge")
    at_row, at_column = np.indices(large.shape)
    place = np.stack([at_column - columns, at_row - rows], axis=-1).astype(np.float64)
    along, across = place @ line.along, place @ line.direction
    offset = across - _extended(along, line.at, line.across)
    step = 0.5 * float(np.mean(np.diff(line.at))) + _END_PX
    beside = _outside(along, line.at[0] - step, line.at[-1] + step) < 1.0

    def sampled(shift: FloatArray) -> FloatArray:
        """Gray levels at a distance from each place along the direction of displacement."""
        at = (place + shift[..., None] * line.direction + corner).astype(np.float32)
        found = cv2.remap(large, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, dtype=np.float64)

    # The line is replaced by the background on both sides of it, interpolated.
    far = _REACH_PX + _BESIDE_PX
    weight = np.clip(0.5 + 0.5 * offset / far, 0.0, 1.0)
    filled = (1.0 - weight) * sampled(-far - offset) + weight * sampled(far - offset)
    share = np.clip(far - np.abs(offset), 0.0, 1.0) * beside
    background = share * filled + (1.0 - share) * large

    def moved(move: FloatArray) -> NDArray[np.uint8]:
        # Within the reach of the line the moved pixels, beyond it the background, with a seam of a few px.
        share = np.clip(_REACH_PX + 1.0 - np.abs(offset - move), 0.0, 1.0) * beside
        return to_gray(share * sampled(-move) + (1.0 - share) * background)

    return np.stack([moved(_extended(along, line.at, move)) for move in moves])


def write_film(path: Path, film: ExaggeratedFilm, mode: str) -> int:
    """Write a film of some cycles with the mode's name, its frequency and the factor; returns the number of frames."""
    label = f"{mode}, {film.frequency_hz:.4g} Hz, x {film.factor:g}"

    def drawn() -> Iterator[NDArray[np.uint8]]:
        _, height, width = film.images.shape
        aside = max(0, _LEAST_WIDTH_PX - width) // 2
        for image in np.concatenate([film.images] * _CYCLES):
            canvas = np.zeros((height + _LABEL_PX, width + 2 * aside, 3), np.uint8)
            canvas[_LABEL_PX:, aside : aside + width] = image[..., None]
            write_label(canvas, label)
            yield canvas

    with replacing(path) as temporary:
        return encode(temporary, drawn(), _FPS)


def _extended(along: FloatArray, at: FloatArray, values: FloatArray) -> FloatArray:
    """Values of the stations between them, and straight on beyond the first and the last."""
    first, last = ((values[k + 1] - values[k]) / (at[k + 1] - at[k]) for k in (0, at.size - 2))
    beyond = last * np.maximum(along - at[-1], 0.0) + first * np.minimum(along - at[0], 0.0)
    return np.asarray(
        np.interp(along, at, values) + beyond * (_outside(along, at[0], at[-1]) < 2.0 * _END_PX)
    )


def _outside(along: FloatArray, first: float, last: float) -> FloatArray:
    """Distance from the nearer end of the line, 0 beside the line itself."""
    return np.asarray(np.maximum(np.maximum(first - along, along - last), 0.0))


def _round_factor(value: float) -> float:
    """The largest of 1, 2, 5, 10, ... that is not above a positive value."""
    power = 10.0 ** floor(log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9))
