"""One frame after the other: fast where nothing happens, with care where something does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.follow.batch import FOLLOWED, UNTOUCHED, all_plain, believed, follow_plain
from tracker.follow.fits import LEAST_CORRELATION, RULES, Fits
from tracker.follow.frame_results import BITS, SEEN_SHARE, FrameResult, missing_row, taken_over
from tracker.follow.predict import Predictor
from tracker.follow.recovery import Recovery
from tracker.markers.base import MarkerDetector
from tracker.register import kernel
from tracker.register.marker import Camera, MarkerModel
from tracker.template.blur import SMALLEST_PX, exposed_path_px, path_length_px


@dataclass(frozen=True)
class _Pending:
    """A frame whose blur is known better once the next one was followed."""

    image: GrayImage
    results: FloatArray
    marks: NDArray[np.uint32]
    warps: FloatArray
    motion: FloatArray
    shown: FrameResult


class Follower:
    """Follows calibrated markers through a recording, one frame after the other.

    Parameters
    ----------
    models : tuple of MarkerModel, length m
    camera : Camera
    detector : MarkerDetector
        Asked again for what was lost.
    exposure_share : float
        Exposure time over the time between frames; 0 when it is not known. Above 0, the calibration's frames must
        be the first ones that are followed, for their motion is where the blur starts from.
    """

    def __init__(
        self, models: tuple[MarkerModel, ...], camera: Camera, detector: MarkerDetector, exposure_share: float
    ) -> None:
        self._camera = camera
        self._noise = camera.noise.as_array()
        self._exposure_share = exposure_share
        self._fits = Fits(models, camera)
        self._recovery = Recovery(self._fits, detector)
        self._predictor = Predictor(len(models))
        self._pending: _Pending | None = None
        for k, model in enumerate(models):
            self._start(k, model)

    def _start(self, k: int, model: MarkerModel) -> None:
        first = model.states[:3, :2]
        seen = model.states[np.all(np.isfinite(model.states[:, :2]), axis=1), :2]
        if self._exposure_share > 0.0 and first.shape == (3, 2) and np.all(np.isfinite(first)):
            # A blurred first frame is told by its motion alone.
            self._predictor.start_moving(k, first)
            self._fits.states[k] = np.nanmedian(model.states, axis=0)
            self._fits.states[k, :2] = first[0]
        elif len(seen):
            self._predictor.start(k, seen[0])
        else:
            self._predictor.start(k, np.array([model.detection.x_px, model.detection.y_px]))

    @property
    def markers(self) -> int:
        """How many markers are followed."""
        return len(self._fits.models)

    def missing(self, flag: int) -> FrameResult:
        """The row of a frame without picture; the windows move on."""
        self._predictor.update(np.full((self.markers, 2), np.nan))
        self._complete()
        return missing_row(self.markers, flag)

    def step(self, image: GrayImage) -> FrameResult:
        """Positions of all markers in the next frame.

        Those of the frame before are bettered in place where it was blurred: a result stands one frame later.
        """
        m = self.markers
        aims, motion, results = np.empty((m, 2)), np.empty((m, 2)), np.empty((m, kernel.RESULT))
        marks, out = np.zeros(m, dtype=np.uint32), np.empty((4, m))
        self._recovery.next_frame()
        way = self._follow_plain(image, aims, motion, results, marks, out)
        if way == FOLLOWED:
            self._complete()
            return FrameResult(out[0], out[1], out[2], out[3], marks)
        if way == UNTOUCHED:
            aims, motion = self._predictor.predict()
            motion *= self._exposure_share
            for k in range(m):
                results[k] = self._fits.register(image, k, aims[k], motion[k])
        self._recover(image, aims, motion, results, marks)
        own_marks, warps = marks.copy(), self._fits.shapes.warps.copy()
        shown = self._finish(results, marks, motion)
        self._complete()
        if self._exposure_share > 0.0 and np.hypot(motion[:, 0], motion[:, 1]).max() >= SMALLEST_PX:
            self._pending = _Pending(image, results, own_marks, warps, motion, shown)
        return shown

    def finish(self) -> None:
        """Complete the last frame, with the motion that its past makes likely."""
        self._predictor.update(np.full((self.markers, 2), np.nan))
        self._complete()

    def _recover(
        self,
        image: GrayImage,
        aims: FloatArray,
        motion: FloatArray,
        results: FloatArray,
        marks: NDArray[np.uint32],
    ) -> None:
        """Look again for what no fit is believed of."""
        fits, recovery = self._fits, self._recovery
        if all_plain(results, fits.states, fits.shapes.limits, RULES):
            return
        for k in range(self.markers):
            if not fits.believed(k, results[k]):
                results[k], marks[k] = recovery.nearby(image, k, aims[k], motion[k])
        recovery.by_detection(image, results, marks, motion)
        recovery.drop_coinciding(results, aims)

    def _complete(self) -> None:
        """Fit the frame before the latest anew where it is blurred, along the path that its neighbours tell."""
        pending, self._pending = self._pending, None
        if pending is None:
            return
        motion, bend = self._predictor.passed()
        for k in range(self.markers):
            path = exposed_path_px(motion[k], bend[k], self._exposure_share)
            first = pending.results[k]
            if not np.all(np.isfinite(first[: kernel.STATE])) or not path_length_px(path) >= SMALLEST_PX:
                continue
            again = self._fits.register_along(pending.image, k, first, pending.warps[k], path)
            usual = self._fits.shapes.limits[k, 0]
            if believed(again, first[kernel.GAIN], usual, RULES, LEAST_CORRELATION):
                pending.results[k] = again
        motion = motion * self._exposure_share
        self._show_again(pending, np.where(np.isfinite(motion), motion, pending.motion))

    def _show_again(self, pending: _Pending, motion: FloatArray) -> None:
        shown, fits = pending.shown, self._fits
        out, _ = taken_over(
            pending.results,
            pending.marks,
            motion,
            pending.warps,
            fits.shapes.centres_uv,
            fits.shapes.limits,
            fits.states.copy(),
            fits.lost.copy(),
        )
        for column, values in zip((shown.x_px, shown.y_px, shown.sd_x_px, shown.sd_y_px), out, strict=True):
            column[:] = values
        # What others have marked the frame with stays.
        shown.flags[:] = (shown.flags & ~np.bitwise_or.reduce(BITS)) | pending.marks

    def _follow_plain(
        self,
        image: GrayImage,
        aims: FloatArray,
        motion: FloatArray,
        results: FloatArray,
        marks: NDArray[np.uint32],
        out: FloatArray,
    ) -> int:
        fits, shapes = self._fits, self._fits.shapes
        way = follow_plain(
            image,
            self._predictor.memory,
            fits.states,
            fits.gains,
            fits.lost,
            shapes.warps,
            shapes.coefs,
            shapes.support,
            shapes.places,
            shapes.shapes,
            shapes.centres_uv,
            shapes.limits,
            self._noise,
            self._camera.saturation,
            self._exposure_share,
            SMALLEST_PX if self._exposure_share > 0.0 else np.inf,
            RULES,
            SEEN_SHARE,
            BITS,
            aims,
            motion,
            results,
            marks,
            out,
        )
        return int(way)

    def _finish(self, results: FloatArray, marks: NDArray[np.uint32], motion: FloatArray) -> FrameResult:
        fits, shapes = self._fits, self._fits.shapes
        out, places = taken_over(
            results, marks, motion, shapes.warps, shapes.centres_uv, shapes.limits, fits.states, fits.lost
        )
        gains = fits.states[:, kernel.GAIN]
        fits.gains = np.where(np.isfinite(gains), gains, fits.gains)
        self._predictor.update(places)
        return FrameResult(out[0], out[1], out[2], out[3], marks)
