"""Finding markers again that were lost, and dropping those that cannot be what they seem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import FloatArray, GrayImage
from tracker.follow.batch import correlation
from tracker.follow.fits import GOOD_CHI2, LEAST_CORRELATION_AFTER_SEARCH, REFRESH_CORRELATION, Fits
from tracker.follow.search import coarse_search
from tracker.markers.base import Detection, MarkerDetector
from tracker.register import kernel
from tracker.template.blur import SMALLEST_PX

# An ArUco marker's shape is looked at anew at most every so many frames.
REFRESH_EVERY = 5
# Detection in the whole picture is slow: after this many frames without success it is tried now and then.
PATIENCE = 200
IMPATIENT_EVERY = 10
# Corners alone are good to about this: the sd of a position that no fit confirms.
DETECTION_SD_PX = 0.5
_NEAR = 0.4


class Recovery:
    """Searches nearby first, then asks the detector, for the markers that `Fits` holds."""

    def __init__(self, fits: Fits, detector: MarkerDetector) -> None:
        self._fits = fits
        self._detector = detector
        self._since_refresh = np.full(len(fits.models), REFRESH_EVERY)

    def next_frame(self) -> None:
        """Count a frame since a marker's shape was last looked at."""
        self._since_refresh += 1

    def nearby(self, image: GrayImage, k: int, aim: FloatArray, motion: FloatArray) -> tuple[FloatArray, int]:
        """Search a window that grows with the time since the loss; a failed result when nothing fits."""
        fits, model = self._fits, self._fits.models[k]
        wider = 8.0 + 0.5 * model.detection.size_px + 4.0 * min(fits.lost[k], 15)
        for centre in (aim, fits.states[k, :2]):
            if not np.all(np.isfinite(centre)):
                continue
            warp, gain = fits.shapes.warps[k], float(fits.gains[k])
            place = coarse_search(image, centre, wider, model.template, warp, gain)
            if place is None:
                continue
            for blur in _blurs(motion):
                result = fits.register(image, k, place, blur)
                if fits.believed(k, result, LEAST_CORRELATION_AFTER_SEARCH):
                    return result, flags.RECOVERED.value
        return _failed(), 0

    def by_detection(
        self, image: GrayImage, results: FloatArray, marks: NDArray[np.uint32], motion: FloatArray
    ) -> None:
        """Ask the detector for markers that are lost, and for the shape of those that fit badly."""
        models = self._fits.models
        wanted = [k for k in range(len(models)) if self._is_wanted(k, results[k])]
        if not wanted:
            return
        by_name = {models[k].detection.name: k for k in wanted}
        for detection in self._detector.redetect(image, tuple(self._last_seen(k) for k in wanted)):
            k = by_name[detection.name]
            results[k], marks[k] = self._reshape(image, k, detection, results[k], int(marks[k]), motion[k])
        self._since_refresh[wanted] = 0

    def _is_wanted(self, k: int, result: FloatArray) -> bool:
        model, lost = self._fits.models[k], self._fits.lost[k]
        if result[kernel.CONVERGED] == 0.0 and (lost < PATIENCE or lost % IMPATIENT_EVERY == 0):
            return True
        return bool(
            model.detection.kind == "aruco"
            and correlation(result) < REFRESH_CORRELATION
            and result[kernel.CHI2] > GOOD_CHI2 * max(1.0, model.chi2)
            and self._since_refresh[k] >= REFRESH_EVERY
        )

    def _last_seen(self, k: int) -> Detection:
        detection, state = self._fits.models[k].detection, self._fits.states[k]
        if np.isnan(state[0]):
            return detection
        return replace(detection, x_px=float(state[0]), y_px=float(state[1]))

    def _reshape(
        self,
        image: GrayImage,
        k: int,
        detection: Detection,
        before: FloatArray,
        mark: int,
        motion: FloatArray,
    ) -> tuple[FloatArray, int]:
        """Register with the shape of a detection; its corners alone when no fit confirms them."""
        fits, model = self._fits, self._fits.models[k]
        was_lost = before[kernel.CONVERGED] == 0.0
        warp = model.refine @ detection.warp if detection.kind == "aruco" else fits.shapes.warps[k].copy()
        place = np.array([detection.x_px, detection.y_px])
        tried = [fits.register(image, k, place, blur, warp) for blur in _blurs(motion)]
        result = max(tried, key=correlation)
        if fits.believed(k, result) and (was_lost or correlation(result) > correlation(before)):
            fits.shapes.set_warp(k, warp)
            return result, mark | (flags.RECOVERED.value if was_lost else 0)
        if not was_lost or detection.kind != "aruco":
            return before, mark
        fits.shapes.set_warp(k, warp)
        fits.states[k] = np.nan
        return _corners_only(place), mark | flags.RECOVERED.value | flags.POOR_FIT.value

    def drop_coinciding(self, results: FloatArray, aims: FloatArray) -> None:
        """Two markers in one place: the one that jumped farther is the wrong one."""
        places = results[:, :2].copy()
        for k in range(len(results)):
            near = _NEAR * self._fits.models[k].detection.size_px
            for other in range(k):
                if np.hypot(*(places[k] - places[other])) < near:
                    jumps = np.linalg.norm(places[[k, other]] - aims[[k, other]], axis=1)
                    loser = k if jumps[0] >= jumps[1] else other
                    results[loser] = _failed()
                    places[loser] = np.nan


def _blurs(motion: FloatArray) -> list[FloatArray]:
    """Motions with which a marker is looked for: the foretold one, and none, as a lost one may have stopped."""
    still = np.zeros(2)
    return [motion, still] if np.hypot(motion[0], motion[1]) >= SMALLEST_PX else [still]


def _failed() -> FloatArray:
    result = np.full(kernel.RESULT, np.nan)
    result[kernel.CONVERGED] = 0.0
    return result


def _corners_only(place: FloatArray) -> FloatArray:
    """What a detection that no fit confirms tells."""
    result = np.full(kernel.RESULT, np.nan)
    result[[kernel.X, kernel.Y]] = place
    result[[kernel.SD_X, kernel.SD_Y]] = DETECTION_SD_PX
    result[[kernel.CONVERGED, kernel.CHI2, kernel.SEEN, kernel.SATURATED]] = (1.0, 1.0, 1.0, 0.0)
    return result
