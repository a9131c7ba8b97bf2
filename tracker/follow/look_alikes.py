"""Markers of the same appearance: which of them is where is decided for all together."""

from __future__ import annotations

import numpy as np

from tracker import flags
from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.follow.batch import COINCIDENT, FrameArrays
from tracker.follow.fits import Fits
from tracker.follow.recovery import IMPATIENT_EVERY, PATIENCE, Recovery, blurs, failed
from tracker.markers import Assignment, CommonMotion, Expectation, LookAlikeDetector, Scene, assign, completed
from tracker.register import correlation, kernel

# Identities are in doubt while predictions err by more than this share of the spacing between markers.
DOUBTFUL = 0.25


class LookAlikes:
    """Assigns fits and detected candidates of a frame to markers that only their order distinguishes.

    A fit that matches the template proves that there is a marker, not which: a lost marker is therefore never taken
    from the surroundings of its last position, but from the assignment of everything seen to all markers together.
    """

    def __init__(self, fits: Fits, detector: LookAlikeDetector, recovery: Recovery) -> None:
        self._fits, self._detector, self._recovery = fits, detector, recovery
        self._sizes = np.array([m.detection.size_px for m in fits.models])
        self._size_px = float(np.median(self._sizes))
        first = np.array([_first_position(m.states, m.detection.x_px, m.detection.y_px) for m in fits.models])
        self._motion = CommonMotion(first, self._size_px)

    def is_doubtful(self) -> bool:
        """Whether a marker is lost, or predictions have failed lately; to be called once a frame."""
        last = self._fits.last
        lost = last.lost > 0
        self._motion.saw(np.where(lost[:, None], np.nan, last.states[:, :2]))
        return bool(lost.any()) or self._motion.is_unpredictable(DOUBTFUL)

    def resolve(self, image: GrayImage, frame: FrameArrays) -> BoolArray:
        """Replace the results of a frame by those of the joint assignment; markers that stay ambiguous, shape (m,)."""
        fits, lost = self._fits, self._fits.last.lost
        markers = range(len(fits.models))
        accepted = np.array([fits.accepted(k, frame.results[k]) for k in markers])
        if self._may_wait(accepted):
            for k in np.flatnonzero(lost > 0).tolist():
                frame.results[k] = failed()
            return np.zeros(len(accepted), dtype=bool)
        for k in np.flatnonzero(~accepted).tolist():
            frame.results[k], frame.marks[k] = self._recovery.nearby(image, k, frame.aims[k], frame.motion[k])
            accepted[k] = frame.results[k, kernel.CONVERGED] != 0.0
        scene = self._scene(image, frame, self._motion.expect(frame.aims, lost == 0), accepted)
        found = assign(scene)
        for k in markers:
            self._take(image, k, frame, scene, found, own=bool(accepted[k]))
        self._recovery.drop_coinciding(frame.results, scene.expected_px)
        self._motion.assigned(found.motion_px, completed(frame.results[:, :2], self._motion.form_px))
        # Found by a search, but never lost.
        frame.marks[lost == 0] &= ~np.uint32(flags.RECOVERED.value)
        return found.ambiguous

    def _may_wait(self, accepted: BoolArray) -> bool:
        """Whether only markers are missing that have been for long, and it is not their turn."""
        lost = self._fits.last.lost
        waiting = (lost >= PATIENCE) & (lost % IMPATIENT_EVERY != 0)
        return bool(
            np.all(waiting | ((lost == 0) & accepted)) and not self._motion.is_unpredictable(DOUBTFUL)
        )

    def _scene(
        self, image: GrayImage, frame: FrameArrays, expected: Expectation, accepted: BoolArray
    ) -> Scene:
        """Candidates of the detector and accepted fits without one: blur hides dots from a detector."""
        sought = tuple(m.detection.at(at) for m, at in zip(self._fits.models, expected.where_px, strict=True))
        seen = self._detector.candidates(image, sought)
        spots = list(seen.centres_px)
        for k in np.flatnonzero(accepted):
            at = frame.results[k, :2]
            if all(np.hypot(*(at - spot)) > COINCIDENT * self._sizes[k] for spot in spots):
                spots.append(at.copy())
        return Scene(expected, np.array(spots).reshape(-1, 2), self._size_px, seen.corners_px)

    def _take(
        self, image: GrayImage, k: int, frame: FrameArrays, scene: Scene, found: Assignment, *, own: bool
    ) -> None:
        """Result of marker k: its own fit where that is the assigned spot, else a fit there, else none."""
        chosen = found.spots[k]
        if chosen < 0:
            frame.results[k] = failed()
            return
        spot, near = scene.spots_px[chosen], COINCIDENT * self._sizes[k]
        if own and np.hypot(*(frame.results[k, :2] - spot)) < near:
            return
        fitted = [self._fits.register(image, k, spot, blur) for blur in blurs(frame.motion[k])]
        best = max(fitted, key=correlation)
        if self._fits.accepted(k, best) and np.hypot(*(best[:2] - spot)) < near:
            frame.results[k], frame.marks[k] = best, flags.RECOVERED.value
        else:
            frame.results[k] = failed()


def _first_position(states: FloatArray, x_px: float, y_px: float) -> FloatArray:
    seen = np.flatnonzero(np.isfinite(states[:, 0]))
    return states[seen[0], :2] if seen.size else np.array([x_px, y_px])
