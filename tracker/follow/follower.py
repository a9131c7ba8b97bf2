"""Frame-by-frame tracking: one compiled call where nothing special happens, closer examination where it does.

Lost markers are searched for one by one, or all of the same appearance together; coincident fits are removed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker import flags
from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import BoolArray, FlagArray, FloatArray, GrayImage
from tracker.follow.fits import (
    BLURRED,
    COINCIDENT,
    EDGE,
    FOLLOWED,
    NOT_FOUND,
    POOR_FIT,
    REFRESH_CORRELATION,
    SATURATED,
    UNTOUCHED,
    Fits,
    FrameArrays,
    LastSeen,
    all_plain,
    follow_plain,
    frame_arrays,
    store_fits,
)
from tracker.follow.fits import TUNING as FITS
from tracker.follow.predict import Predictor
from tracker.markers import (
    Assignment,
    CommonMotion,
    Detection,
    Expectation,
    MarkerDetector,
    Scene,
    SimilarMarkerDetector,
    assign,
    completed,
)
from tracker.register import Camera, MarkerModel, coarse_search, correlation, kernel, picture
from tracker.template import blur as motion_blur
from tracker.template import exposed_path_px, is_blur, path_length_px

OWN_FLAGS = NOT_FOUND | EDGE | SATURATED | BLURRED | POOR_FIT


@dataclass(frozen=True)
class Tuning:
    """Search for lost markers."""

    #: [frames] in which the shape of a marker is measured again at most once
    #: convention: limits time
    refresh_every: int = 5
    #: [frames] without success after which a marker is sought only occasionally
    #: convention: detection in the whole image is slow
    patience: int = 200
    #: [frames] in which it then is sought once
    #: convention: limits time
    impatient_every: int = 10
    #: [px] sd of a position from corners alone, which no fit confirms
    #: convention: corners found in one frame err by some tenths of a px
    detection_sd_px: float = 0.5
    #: [1] of the spacing between markers, by which predictions err where identities are in doubt
    #: physics: half of the distance at which a neighbour is as near
    doubtful: float = 0.25
    #: [1] of the marker's size that is added
    reach_size: float = 0.5
    #: [px] that are added for each frame since it was lost
    reach_step_px: float = 4.0
    #: [frames] for which they are
    #: convention: limits time
    most_steps: int = 15


TUNING = Tuning()


class Recovery:
    """Searches for lost markers nearby first, then by detection."""

    def __init__(self, fits: Fits, detector: MarkerDetector) -> None:
        self._fits = fits
        self._detector = detector
        self._since_refresh = np.full(len(fits.models), TUNING.refresh_every)

    def next_frame(self) -> None:
        """Count a frame since each marker's shape was last measured."""
        self._since_refresh += 1

    def nearby(self, image: GrayImage, k: int, aim: FloatArray, motion: FloatArray) -> tuple[FloatArray, int]:
        """Search a window that grows with the time since the loss; a failed result when nothing fits."""
        fits, model = self._fits, self._fits.models[k]
        wider = ACCEPTANCE.reach_px + TUNING.reach_size * model.detection.size_px
        wider += TUNING.reach_step_px * min(fits.last.lost[k], TUNING.most_steps)
        for centre in (aim, fits.last.states[k, :2]):
            if not np.all(np.isfinite(centre)):
                continue
            warp, gain = fits.arrays.warps[k], float(fits.last.gains[k])
            found = coarse_search(image, centre, wider, model.template, warp, gain)
            if found is None:
                continue
            for blur in blurs(motion):
                result = fits.register(image, k, found, blur)
                if fits.accepted(k, result, FITS.least_correlation_after_search):
                    return result, flags.RECOVERED.value
        return failed(), 0

    def by_detection(
        self, image: GrayImage, results: FloatArray, marks: FlagArray, motion: FloatArray
    ) -> None:
        """Detect lost markers, and the shape of those that fit badly."""
        models = self._fits.models
        sought = [k for k in range(len(models)) if self._is_wanted(k, results[k])]
        if not sought:
            return
        by_name = {models[k].detection.name: k for k in sought}
        for detection in self._detector.redetect(image, tuple(self._last_seen(k) for k in sought)):
            k = by_name[detection.name]
            results[k], marks[k] = self._reshape(image, detection, k, results[k], int(marks[k]), motion[k])
        self._since_refresh[sought] = 0

    def _is_wanted(self, k: int, result: FloatArray) -> bool:
        model, lost = self._fits.models[k], self._fits.last.lost[k]
        if result[kernel.CONVERGED] == 0.0 and (lost < TUNING.patience or lost % TUNING.impatient_every == 0):
            return True
        return bool(
            model.detection.kind.decodes_shape
            and correlation(result) < REFRESH_CORRELATION
            and result[kernel.CHI2] > ACCEPTANCE.good_chi2 * max(1.0, model.chi2)
            and self._since_refresh[k] >= TUNING.refresh_every
        )

    def _last_seen(self, k: int) -> Detection:
        detection, state = self._fits.models[k].detection, self._fits.last.states[k]
        return detection if np.isnan(state[0]) else detection.at(state[:2])

    def _reshape(
        self,
        image: GrayImage,
        detection: Detection,
        k: int,
        before: FloatArray,
        mark: int,
        motion: FloatArray,
    ) -> tuple[FloatArray, int]:
        """Register with the shape of a detection; its corners alone when no fit confirms them."""
        fits, model, decoded = self._fits, self._fits.models[k], detection.kind.decodes_shape
        was_lost = before[kernel.CONVERGED] == 0.0
        # The shape before the loss is more accurate than that of one detection, unless the marker has turned.
        shapes = [fits.arrays.warps[k].copy()]
        if decoded:
            shapes.append(model.refine @ detection.warp)
        centre = np.array([detection.x_px, detection.y_px])
        tried = [(fits.register(image, k, centre, b, warp), warp) for warp in shapes for b in blurs(motion)]
        result, warp = max(tried, key=lambda one: correlation(one[0]))
        if fits.accepted(k, result) and (was_lost or correlation(result) > correlation(before)):
            fits.set_warp(k, warp)
            return result, mark | (flags.RECOVERED.value if was_lost else 0)
        if not was_lost or not decoded:
            return before, mark
        fits.set_warp(k, shapes[-1])
        fits.last.states[k] = np.nan
        return _corners_only(centre), mark | flags.RECOVERED.value | flags.POOR_FIT.value

    def drop_coinciding(self, results: FloatArray, aims: FloatArray) -> None:
        """Of two markers at one position, drop the one farther from its prediction."""
        positions = results[:, :2].copy()
        for k in range(len(results)):
            near = COINCIDENT * self._fits.models[k].detection.size_px
            for other in range(k):
                if np.hypot(*(positions[k] - positions[other])) < near:
                    jumps = np.linalg.norm(positions[[k, other]] - aims[[k, other]], axis=1)
                    loser = k if jumps[0] >= jumps[1] else other
                    results[loser] = failed()
                    positions[loser] = np.nan


def blurs(motion: FloatArray) -> list[FloatArray]:
    """Motions to search with: the predicted one, and none, as a lost marker may have stopped."""
    still = np.zeros(2)
    return [motion, still] if is_blur(np.hypot(motion[0], motion[1])) else [still]


def failed() -> FloatArray:
    """Result of a marker that was not found."""
    result = np.full(kernel.RESULT, np.nan)
    result[kernel.CONVERGED] = 0.0
    return result


def _corners_only(centre: FloatArray) -> FloatArray:
    """Result of a detection that no fit confirms."""
    result = np.full(kernel.RESULT, np.nan)
    result[[kernel.X, kernel.Y]] = centre
    result[[kernel.SD_X, kernel.SD_Y]] = TUNING.detection_sd_px
    result[[kernel.CONVERGED, kernel.CHI2, kernel.SEEN, kernel.SATURATED]] = (1.0, 1.0, 1.0, 0.0)
    return result


class SimilarMarkers:
    """Assigns fits and detected candidates of a frame to markers that only their order distinguishes.

    A fit that matches the template proves that there is a marker, not which: a lost marker is therefore never taken
    from the surroundings of its last position, but from the assignment of everything seen to all markers together.
    """

    def __init__(self, fits: Fits, detector: SimilarMarkerDetector, recovery: Recovery) -> None:
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
        return bool(lost.any()) or self._motion.is_unpredictable(TUNING.doubtful)

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
        waiting = (lost >= TUNING.patience) & (lost % TUNING.impatient_every != 0)
        return bool(
            np.all(waiting | ((lost == 0) & accepted)) and not self._motion.is_unpredictable(TUNING.doubtful)
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


@dataclass(frozen=True)
class _Pending:
    """A frame whose blur is better known once the next frame has been tracked."""

    image: GrayImage
    frame: FrameArrays
    marks: FlagArray
    warps: FloatArray


class Follower:
    """Tracks calibrated markers through a recording, frame by frame; the detector is used again for lost ones.

    With a known exposure, tracking must begin with the calibration frames, whose motion is the start of the blur model.
    """

    def __init__(
        self, models: tuple[MarkerModel, ...], camera: Camera, detector: MarkerDetector, exposure_share: float
    ) -> None:
        self._camera = camera.pixels
        self._exposure_share = exposure_share
        self._fits = Fits(models, camera)
        self._recovery = Recovery(self._fits, detector)
        self._similar: SimilarMarkers | None = None
        if isinstance(detector, SimilarMarkerDetector):
            self._similar = SimilarMarkers(self._fits, detector, self._recovery)
        self._predictor = Predictor(len(models))
        self._pending: _Pending | None = None
        for k, model in enumerate(models):
            self._start(k, model)

    def _start(self, k: int, model: MarkerModel) -> None:
        first = model.states[:3, :2]
        seen = model.states[np.all(np.isfinite(model.states[:, :2]), axis=1), :2]
        if self._exposure_share > 0.0 and first.shape == (3, 2) and np.all(np.isfinite(first)):
            # A blurred first frame can only be fitted with its motion known.
            self._predictor.start_moving(k, first)
            self._fits.last.states[k] = np.nanmedian(model.states, axis=0)
            self._fits.last.states[k, : kernel.GAIN] = model.states[0, : kernel.GAIN]
        elif len(seen):
            self._predictor.start(k, seen[0])
            if model.with_angle:
                # The detection may be of a frame in which a rotating marker had turned.
                complete = np.all(np.isfinite(model.states), axis=1)
                self._fits.last.states[k] = model.states[np.argmax(complete)]
        else:
            self._predictor.start(k, np.array([model.detection.x_px, model.detection.y_px]))

    @property
    def markers(self) -> int:
        """Number of markers."""
        return len(self._fits.models)

    def missing(self, flag: int) -> FrameArrays:
        """Result of a frame without image; predictions move on."""
        self.finish()
        frame = frame_arrays(self.markers)
        frame.out[:], frame.marks[:] = np.nan, flag | NOT_FOUND
        return frame

    def step(self, image: GrayImage) -> FrameArrays:
        """Positions of all markers in the next frame; final one frame later."""
        frame = frame_arrays(self.markers)
        self._recovery.next_frame()
        joint = self._similar
        # Where identities are in doubt, a fit of the right appearance proves nothing: no frame is followed plainly.
        doubt = joint is not None and joint.is_doubtful()
        least_px = motion_blur.TUNING.smallest_px
        most_blur_px = -1.0 if doubt else least_px if self._exposure_share > 0.0 else np.inf
        outcome = follow_plain(
            picture(image),
            self._predictor.memory,
            self._fits.last,
            self._fits.arrays,
            self._camera,
            self._exposure_share,
            most_blur_px,
            frame,
        )
        if outcome == FOLLOWED:
            self._complete()
            return frame
        if outcome == UNTOUCHED:
            aims, motion = self._predictor.predict()
            frame = frame._replace(aims=aims, motion=motion * self._exposure_share)
            for k in range(self.markers):
                frame.results[k] = self._fits.register(image, k, aims[k], frame.motion[k])
        ambiguous = np.zeros(self.markers, dtype=bool)
        if doubt or not all_plain(frame.results, self._fits.last.states, self._fits.arrays.limits):
            if joint is None:
                self._recover(image, frame)
            else:
                ambiguous = joint.resolve(image, frame)
        marks, warps = frame.marks.copy(), self._fits.arrays.warps.copy()
        self._store(frame)
        frame.marks[ambiguous] |= np.uint32(flags.AMBIGUOUS.value)
        self._complete()
        if self._exposure_share > 0.0 and is_blur(np.hypot(*frame.motion.T).max()):
            self._pending = _Pending(image, frame, marks, warps)
        return frame

    def finish(self) -> None:
        """Complete the last frame, with its motion predicted from the past."""
        self._predictor.update(np.full((self.markers, 2), np.nan))
        self._complete()

    def _recover(self, image: GrayImage, frame: FrameArrays) -> None:
        """Search again for markers without an acceptable fit."""
        fits, recovery = self._fits, self._recovery
        for k in range(self.markers):
            if not fits.accepted(k, frame.results[k]):
                frame.results[k], frame.marks[k] = recovery.nearby(image, k, frame.aims[k], frame.motion[k])
        recovery.by_detection(image, frame.results, frame.marks, frame.motion)
        recovery.drop_coinciding(frame.results, frame.aims)

    def _store(self, frame: FrameArrays) -> None:
        last, arrays, positions = self._fits.last, self._fits.arrays, np.empty((self.markers, 2))
        store_fits(frame, arrays.warps, arrays.centres_uv, arrays.limits, last, positions)
        gains = last.states[:, kernel.GAIN]
        last.gains[:] = np.where(np.isfinite(gains), gains, last.gains)
        self._predictor.update(positions)

    def _complete(self) -> None:
        """Fit the previous frame again where it is blurred, along the path given by its neighbours."""
        pending, self._pending = self._pending, None
        if pending is None:
            return
        motion, bend = self._predictor.passed()
        results = pending.frame.results
        for k in range(self.markers):
            path = exposed_path_px(motion[k], bend[k], self._exposure_share)
            first = results[k]
            if not np.all(np.isfinite(first[: kernel.STATE])) or not is_blur(path_length_px(path)):
                continue
            again = self._fits.register_along(pending.image, k, first, pending.warps[k], path)
            if self._fits.accepted(k, again, gain=first[kernel.GAIN]):
                results[k] = again
        motion = motion * self._exposure_share
        motion = np.where(np.isfinite(motion), motion, pending.frame.motion)
        shown, arrays, last = pending.frame, self._fits.arrays, self._fits.last
        frame = pending.frame._replace(motion=motion, marks=pending.marks, out=np.empty((4, self.markers)))
        untouched = LastSeen(last.states.copy(), last.gains, last.light.copy(), last.lost.copy())
        unused = np.empty((self.markers, 2))
        store_fits(frame, pending.warps, arrays.centres_uv, arrays.limits, untouched, unused)
        shown.out[:] = frame.out
        # Flags set by others meanwhile remain.
        shown.marks[:] = (shown.marks & ~np.uint32(OWN_FLAGS)) | frame.marks
