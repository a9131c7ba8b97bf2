"""Registration of markers from their last good state: one by one, or all of a frame in one compiled call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from tracker import flags
from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import FlagArray, FloatArray, GrayImage, IntArray
from tracker.follow.predict import Memory, predict_all, update_all
from tracker.register import (
    Camera,
    MarkerModel,
    Picture,
    acceptable,
    contrast_state,
    correlation,
    kernel,
    reconsider,
    register,
)
from tracker.template import BlurBank, Template, is_blur, seen_from_marker


@dataclass(frozen=True)
class Tuning:
    """Reach of a registration, and when a fit needs closer examination."""

    #: [px] from the prediction at which a fit fails
    shift_px: float = 4.0
    #: [1] of the marker's size that is added
    shift_share: float = 0.2
    #: [1] correlation of a fit that a search found
    #: convention: then a neighbouring marker of similar appearance is the main risk
    least_correlation_after_search: float = 0.92
    #: [1] below it the shape of a marker that decodes it is measured again
    refresh_correlation: float = 0.97
    #: [1] of its size, within which two positions are those of one marker
    #: convention: two markers do not overlap
    coincident: float = 0.4


TUNING = Tuning()
# Frozen into compiled code.
LEAST_CORRELATION = ACCEPTANCE.least_correlation
GOOD_CHI2 = ACCEPTANCE.good_chi2
EDGE_SHARE = ACCEPTANCE.edge_share
SATURATED_SHARE = ACCEPTANCE.saturated_share
BLURRED_PX = ACCEPTANCE.blurred_px
POOR_SD = ACCEPTANCE.poor_sd
POOR_RATIO = ACCEPTANCE.poor_ratio
REFRESH_CORRELATION = TUNING.refresh_correlation
COINCIDENT = TUNING.coincident

# Columns of `MarkerArrays.limits`.
TYPICAL_CHI2, SIZE_PX, DECODES_SHAPE, LIMITS = 0, 1, 2, 3
# Outcome of `follow_plain`.
UNTOUCHED, REGISTERED, FOLLOWED = 0, 1, 2

NOT_FOUND, EDGE, SATURATED, BLURRED, POOR_FIT = (
    flag.value for flag in (flags.NOT_FOUND, flags.EDGE, flags.SATURATED, flags.BLURRED, flags.POOR_FIT)
)


class MarkerArrays(NamedTuple):
    """Templates of m markers and their placement in the image.

    `coefs` and `support` hold the grid points of all templates, one template after another; `layout` (m, 5) the first
    grid point of each template, its rows and columns, the stride, and whether the angle is fitted; `scales` (m, 3)
    oversampling, reach and largest shift in px; `limits` (m, LIMITS) typical chi-square, size in px, and whether
    detection measures the marker's shape.
    """

    coefs: NDArray[np.float32]
    support: NDArray[np.uint8]
    layout: IntArray
    warps: FloatArray
    scales: FloatArray
    centres_uv: FloatArray
    limits: FloatArray


class LastSeen(NamedTuple):
    """Last good state of m markers (m, STATE), gain (m,), share of uneven light (m,), frames since it was seen (m,)."""

    states: FloatArray
    gains: FloatArray
    light: FloatArray
    lost: IntArray


class FrameArrays(NamedTuple):
    """Arrays of one frame: predictions and motion (m, 2), fits (m, RESULT), flags (m,), x, y and their sd (4, m), px.

    Where the exposure is known, flags and positions of blurred markers are completed in place by the next step or by
    `Follower.finish`: the path during an exposure follows from the frames on both sides.
    """

    aims: FloatArray
    motion: FloatArray
    results: FloatArray
    marks: FlagArray
    out: FloatArray

    @property
    def correlation(self) -> None:
        """None: a template gives both coordinates, with errors that count as independent."""


def frame_arrays(markers: int) -> FrameArrays:
    """Empty arrays for one frame."""
    return FrameArrays(
        np.empty((markers, 2)),
        np.empty((markers, 2)),
        np.empty((markers, kernel.RESULT)),
        np.zeros(markers, dtype=np.uint32),
        np.empty((4, markers)),
    )


@register_jitable(error_model="numpy")
def register_all(
    image: Picture,
    aims: FloatArray,
    last: LastSeen,
    markers: MarkerArrays,
    camera: kernel.Pixels,
    results: FloatArray,
) -> None:
    """Register m markers, each with its template at rest, and fill `results`; see `kernel.register`."""
    start = np.empty(kernel.STATE)
    space = kernel.make_workspace()
    for k in range(aims.shape[0]):
        first, rows, cols = markers.layout[k, 0], markers.layout[k, 1], markers.layout[k, 2]
        size = rows * cols
        # Entry by entry: compiling an array assignment takes numba two seconds.
        for i in range(2, kernel.STATE):
            start[i] = last.states[k, i]
        start[0] = aims[k, 0]
        start[1] = aims[k, 1]
        template = kernel.Grid(
            markers.coefs[first : first + size].reshape((rows, cols)),
            markers.support[first : first + size].reshape((rows, cols)),
            markers.scales[k, 0],
            markers.scales[k, 1],
            markers.layout[k, 3],
        )
        with_angle, max_shift = markers.layout[k, 4] != 0, markers.scales[k, 2]
        kernel.register(
            image, start, markers.warps[k], template, camera, space, with_angle, max_shift, results[k]
        )
        results[k, kernel.LIGHT] = last.light[k]
        reconsider(image, markers.warps[k], template, camera, space, with_angle, max_shift, results[k])


@njit(cache=True, nogil=True, error_model="numpy")
def all_plain(results: FloatArray, states: FloatArray, limits: FloatArray) -> bool:
    """Whether every fit is acceptable, no two markers coincide and none fits so badly that its shape is in doubt."""
    for k in range(results.shape[0]):
        typical = limits[k, TYPICAL_CHI2]
        if not acceptable(results[k], states[k, 3], typical, LEAST_CORRELATION):
            return False
        if (
            limits[k, DECODES_SHAPE] != 0.0
            and results[k, kernel.CHI2] > GOOD_CHI2 * typical
            and correlation(results[k]) < REFRESH_CORRELATION
        ):
            return False
        near = COINCIDENT * limits[k, SIZE_PX]
        for other in range(k):
            dx, dy = results[k, 0] - results[other, 0], results[k, 1] - results[other, 1]
            if dx * dx + dy * dy < near * near:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def store_fits(
    frame: FrameArrays,
    warps: FloatArray,
    centres_uv: FloatArray,
    limits: FloatArray,
    last: LastSeen,
    positions: FloatArray,
) -> None:
    """Fill `frame.out` and complete `frame.marks` from `frame.results`; update `last` for the next frame.

    `positions`, shape (m, 2), is filled with the positions for the prediction, NaN where missing.
    """
    out, marks = frame.out, frame.marks
    for k in range(frame.results.shape[0]):
        result = frame.results[k]
        if result[kernel.CONVERGED] == 0.0:
            last.lost[k] += 1
            marks[k] = NOT_FOUND
            positions[k, 0] = positions[k, 1] = np.nan
            for i in range(4):
                out[i, k] = np.nan
            continue
        last.lost[k] = 0
        positions[k, 0], positions[k, 1] = result[0], result[1]
        chi2, pixels = result[kernel.CHI2], max(result[kernel.PIXELS], 1.0)
        enlarged = np.sqrt(max(1.0, chi2))
        cosine, sine = np.cos(result[kernel.ANGLE]), np.sin(result[kernel.ANGLE])
        u = cosine * centres_uv[k, 0] - sine * centres_uv[k, 1]
        v = sine * centres_uv[k, 0] + cosine * centres_uv[k, 1]
        if not np.isfinite(u):
            u, v = 0.0, 0.0
        w = warps[k]
        det = w[0, 0] * w[1, 1] - w[0, 1] * w[1, 0]
        out[0, k] = result[0] + (w[1, 1] * u - w[0, 1] * v) / det
        out[1, k] = result[1] + (w[0, 0] * v - w[1, 0] * u) / det
        out[2, k] = result[kernel.SD_X] * enlarged
        out[3, k] = result[kernel.SD_Y] * enlarged
        if result[kernel.SEEN] < EDGE_SHARE:
            marks[k] |= EDGE
        if result[kernel.SATURATED] > SATURATED_SHARE * pixels:
            marks[k] |= SATURATED
        if np.hypot(frame.motion[k, 0], frame.motion[k, 1]) > BLURRED_PX:
            marks[k] |= BLURRED
        if chi2 > max(1.0 + POOR_SD * np.sqrt(2.0 / pixels), POOR_RATIO * limits[k, TYPICAL_CHI2]):
            marks[k] |= POOR_FIT
        if np.isfinite(result[kernel.GAIN]):
            for i in range(kernel.STATE):
                last.states[k, i] = result[i]
            last.light[k] = result[kernel.LIGHT]


@njit(cache=True, nogil=True, error_model="numpy")
def follow_plain(
    image: Picture,
    memory: Memory,
    last: LastSeen,
    markers: MarkerArrays,
    camera: kernel.Pixels,
    exposure_share: float,
    most_blur: float,
    frame: FrameArrays,
) -> int:
    """Follow all markers through a frame without special events, in one call, and fill `frame`.

    The interpreter lock is released, so that decoding continues in its thread. Templates at rest are not sufficient
    from a motion of `most_blur` px during the exposure on.

    Returns
    -------
    int
        `FOLLOWED` when all is done and `memory` and `last` are updated; `REGISTERED` when aims, motion and results are
        filled, but some marker needs closer examination; `UNTOUCHED` when markers are blurred or have no state.
    """
    aims, motion, results = frame.aims, frame.motion, frame.results
    predict_all(memory, aims, motion)
    for k in range(aims.shape[0]):
        for c in range(2):
            motion[k, c] *= exposure_share
        blur = np.hypot(motion[k, 0], motion[k, 1])
        if not (np.isfinite(last.states[k, kernel.GAIN]) and blur < most_blur):
            return UNTOUCHED
    register_all(image, aims, last, markers, camera, results)
    if not all_plain(results, last.states, markers.limits):
        return REGISTERED
    where = np.empty((aims.shape[0], 2))
    store_fits(frame, markers.warps, markers.centres_uv, markers.limits, last, where)
    for k in range(aims.shape[0]):
        if np.isfinite(last.states[k, kernel.GAIN]):
            last.gains[k] = last.states[k, kernel.GAIN]
    update_all(memory, where)
    return FOLLOWED


class Fits:
    """The markers as last seen, and their registration to an image."""

    def __init__(self, models: tuple[MarkerModel, ...], camera: Camera) -> None:
        self.models = models
        self.arrays = _marker_arrays(models)
        for k, model in enumerate(models):
            self.set_warp(k, model.warp)
        m = len(models)
        self.last = LastSeen(
            np.full((m, kernel.STATE), np.nan), np.ones(m), np.zeros(m), np.zeros(m, dtype=np.int64)
        )
        self._camera = camera
        self._banks = [BlurBank(m.template, m.known) for m in models]

    def set_warp(self, k: int, warp: FloatArray) -> None:
        """Change the shape of marker k in the image from now on."""
        model = self.models[k]
        self.arrays.warps[k] = warp
        self.arrays.layout[k, 3] = model.template.stride(warp)
        shift_px = TUNING.shift_px + TUNING.shift_share * model.detection.size_px
        reach_px = model.template.image_reach_px(warp)
        self.arrays.scales[k] = (model.template.oversampling, reach_px, shift_px)

    def accepted(
        self, k: int, result: FloatArray, least: float | None = None, gain: float | None = None
    ) -> bool:
        """Whether the fit of marker k is the marker, by its last gain unless another is given."""
        least = ACCEPTANCE.least_correlation if least is None else least
        gain = self.last.states[k, kernel.GAIN] if gain is None else gain
        return bool(acceptable(result, gain, self.arrays.limits[k, 0], least))

    def register(
        self, image: GrayImage, k: int, aim: FloatArray, motion: FloatArray, warp: FloatArray | None = None
    ) -> FloatArray:
        """Register one marker, optionally with a newly detected warp (which includes the angle where decoded)."""
        model = self.models[k]
        start = self._start(image, k, aim)
        if warp is None:
            warp = self.arrays.warps[k]
        elif model.detection.kind.decodes_shape:
            start[kernel.ANGLE] = 0.0
        template = model.template
        if is_blur(np.hypot(motion[0], motion[1])):
            path = seen_from_marker(np.stack([motion, np.zeros(2)]), warp, start[kernel.ANGLE])
            template = self._banks[k].get(path[0])
        return self._register(image, k, start, warp, template)

    def register_along(
        self, image: GrayImage, k: int, first: FloatArray, warp: FloatArray, path_px: FloatArray
    ) -> FloatArray:
        """Fit again from the state of a first fit, blurred along `path_px`; see `exposed_path_px`."""
        template = self._banks[k].exact(seen_from_marker(path_px, warp, first[kernel.ANGLE]))
        return self._register(image, k, first[: kernel.STATE], warp, template)

    def _register(
        self, image: GrayImage, k: int, start: FloatArray, warp: FloatArray, template: Template
    ) -> FloatArray:
        with_angle, max_shift_px = self.models[k].with_angle, self.arrays.scales[k, 2]
        return register(
            image,
            start,
            warp,
            template,
            self._camera,
            with_angle=with_angle,
            max_shift_px=max_shift_px,
            light=float(self.last.light[k]),
        )

    def _start(self, image: GrayImage, k: int, aim: FloatArray) -> FloatArray:
        """State from which a fit starts at `aim`."""
        model = self.models[k]
        if np.isfinite(self.last.states[k, kernel.GAIN]):
            return np.concatenate([aim, self.last.states[k, 2:]])
        if model.source == "learned":
            return np.array([aim[0], aim[1], 0.0, 1.0, 0.0])
        return contrast_state(image, model.detection, aim)


def _marker_arrays(models: tuple[MarkerModel, ...]) -> MarkerArrays:
    """Templates one after another; warps, strides and scales are set by `Fits.set_warp`."""
    grids = [model.template.grid for model in models]
    shapes = np.array([support.shape for _, support in grids])
    sizes = shapes.prod(axis=1)
    layout = np.zeros((len(models), 5), dtype=np.int64)
    layout[:, 0] = np.cumsum(sizes) - sizes
    layout[:, 1:3] = shapes
    layout[:, 4] = [model.with_angle for model in models]
    chi2 = [max(1.0, m.chi2) if np.isfinite(m.chi2) else 1.0 for m in models]
    limits = [
        (typical, m.detection.size_px, m.detection.kind.decodes_shape)
        for typical, m in zip(chi2, models, strict=True)
    ]
    return MarkerArrays(
        np.concatenate([coefs.ravel() for coefs, _ in grids]),
        np.concatenate([support.ravel() for _, support in grids]),
        layout,
        np.array([m.warp for m in models]),
        np.zeros((len(models), 3)),
        np.array([m.centre_uv for m in models]),
        np.array(limits, dtype=np.float64).reshape(-1, LIMITS),
    )
