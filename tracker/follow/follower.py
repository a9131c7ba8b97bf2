"""Frame-by-frame tracking: one compiled call where nothing special happens, closer examination where it does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker import flags
from tracker.arrays import FlagArray, FloatArray, GrayImage
from tracker.follow import batch
from tracker.follow.fits import Fits
from tracker.follow.predict import Predictor
from tracker.follow.recovery import Recovery, SimilarMarkers
from tracker.markers import MarkerDetector, SimilarMarkerDetector
from tracker.register import Camera, MarkerModel, kernel, picture
from tracker.template import blur as motion_blur
from tracker.template import exposed_path_px, is_blur, path_length_px

OWN_FLAGS = batch.NOT_FOUND | batch.EDGE | batch.SATURATED | batch.BLURRED | batch.POOR_FIT


@dataclass(frozen=True)
class _Pending:
    """A frame whose blur is better known once the next frame has been tracked."""

    image: GrayImage
    frame: batch.FrameArrays
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

    def missing(self, flag: int) -> batch.FrameArrays:
        """Result of a frame without image; predictions move on."""
        self.finish()
        frame = batch.frame_arrays(self.markers)
        frame.out[:], frame.marks[:] = np.nan, flag | batch.NOT_FOUND
        return frame

    def step(self, image: GrayImage) -> batch.FrameArrays:
        """Positions of all markers in the next frame; final one frame later."""
        frame = batch.frame_arrays(self.markers)
        self._recovery.next_frame()
        joint = self._similar
        # Where identities are in doubt, a fit of the right appearance proves nothing: no frame is followed plainly.
        doubt = joint is not None and joint.is_doubtful()
        least_px = motion_blur.TUNING.smallest_px
        most_blur_px = -1.0 if doubt else least_px if self._exposure_share > 0.0 else np.inf
        outcome = batch.follow_plain(
            picture(image),
            self._predictor.memory,
            self._fits.last,
            self._fits.arrays,
            self._camera,
            self._exposure_share,
            most_blur_px,
            frame,
        )
        if outcome == batch.FOLLOWED:
            self._complete()
            return frame
        if outcome == batch.UNTOUCHED:
            aims, motion = self._predictor.predict()
            frame = frame._replace(aims=aims, motion=motion * self._exposure_share)
            for k in range(self.markers):
                frame.results[k] = self._fits.register(image, k, aims[k], frame.motion[k])
        ambiguous = np.zeros(self.markers, dtype=bool)
        if doubt or not batch.all_plain(frame.results, self._fits.last.states, self._fits.arrays.limits):
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

    def _recover(self, image: GrayImage, frame: batch.FrameArrays) -> None:
        """Search again for markers without an acceptable fit."""
        fits, recovery = self._fits, self._recovery
        for k in range(self.markers):
            if not fits.accepted(k, frame.results[k]):
                frame.results[k], frame.marks[k] = recovery.nearby(image, k, frame.aims[k], frame.motion[k])
        recovery.by_detection(image, frame.results, frame.marks, frame.motion)
        recovery.drop_coinciding(frame.results, frame.aims)

    def _store(self, frame: batch.FrameArrays) -> None:
        last, arrays, positions = self._fits.last, self._fits.arrays, np.empty((self.markers, 2))
        batch.store_fits(frame, arrays.warps, arrays.centres_uv, arrays.limits, last, positions)
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
        untouched = batch.LastSeen(last.states.copy(), last.gains, last.light.copy(), last.lost.copy())
        unused = np.empty((self.markers, 2))
        batch.store_fits(frame, pending.warps, arrays.centres_uv, arrays.limits, untouched, unused)
        shown.out[:] = frame.out
        # Flags set by others meanwhile remain.
        shown.marks[:] = (shown.marks & ~np.uint32(OWN_FLAGS)) | frame.marks
