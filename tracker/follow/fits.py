"""Registering one marker from what is known of it so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.follow.batch import believed
from tracker.follow.shapes import Shapes
from tracker.register import kernel
from tracker.register.marker import Camera, MarkerModel, contrast_state, reach_px, register
from tracker.template.blur import SMALLEST_PX, BlurBank, seen_from_marker

# A fit is believed when the template explains this share of the picture, or its residual is the noise's.
LEAST_CORRELATION = 0.85
# After a search the neighbour with a similar print is the danger.
LEAST_CORRELATION_AFTER_SEARCH = 0.92
GOOD_CHI2 = 3.0
# Chi-square by which the template must beat an even surface: five standard deviations.
LEAST_SIGNAL = 25.0
# A fit below this correlation makes an ArUco marker's shape be looked at anew.
REFRESH_CORRELATION = 0.97
LEAST_SEEN_SHARE = 0.45
RULES = np.array([LEAST_SEEN_SHARE, LEAST_SIGNAL, LEAST_CORRELATION, GOOD_CHI2, REFRESH_CORRELATION])


class Fits:
    """The markers as last seen, and how each is registered to a picture.

    Attributes
    ----------
    models : tuple of MarkerModel, length m
    shapes : Shapes
    states : array, shape (m, STATE)
        Last good state of each marker: NaN where there is none.
    gains : array, shape (m,)
        Last gain, which stays when the rest is lost.
    lost : int array, shape (m,)
        Frames since each marker was seen.
    """

    def __init__(self, models: tuple[MarkerModel, ...], camera: Camera) -> None:
        self.models = models
        self.shapes = Shapes(models)
        m = len(models)
        self.states = np.full((m, kernel.STATE), np.nan)
        self.gains = np.ones(m)
        self.lost = np.zeros(m, dtype=np.int64)
        self._camera = camera
        self._banks = [BlurBank(m.template, m.known) for m in models]

    def believed(self, k: int, result: FloatArray, least: float = LEAST_CORRELATION) -> bool:
        """Whether the fit of marker k is the marker."""
        return bool(believed(result, self.states[k, kernel.GAIN], self.shapes.limits[k, 0], RULES, least))

    def register(
        self, image: GrayImage, k: int, aim: FloatArray, motion: FloatArray, warp: FloatArray | None = None
    ) -> FloatArray:
        """Register one marker, with another warp than its own where one is given (and then at angle 0)."""
        model = self.models[k]
        start = self._start(image, k, aim)
        if warp is None:
            warp = self.shapes.warps[k]
        elif model.detection.kind == "aruco":
            start[kernel.ANGLE] = 0.0
        template = model.template
        if np.hypot(motion[0], motion[1]) >= SMALLEST_PX:
            path = seen_from_marker(np.stack([motion, np.zeros(2)]), warp, start[kernel.ANGLE])
            template = self._banks[k].get(path[0])
        return register(
            image,
            start,
            warp,
            template,
            self._camera,
            reach=reach_px(template, warp),
            with_angle=model.with_angle,
            max_shift_px=self.shapes.shapes[k, 2],
        )

    def register_along(
        self, image: GrayImage, k: int, first: FloatArray, warp: FloatArray, path_px: FloatArray
    ) -> FloatArray:
        """Fit anew from the state of a first fit, blurred along `path_px`; see `exposed_path_px`."""
        template = self._banks[k].exact(seen_from_marker(path_px, warp, first[kernel.ANGLE]))
        return register(
            image,
            first[: kernel.STATE],
            warp,
            template,
            self._camera,
            reach=reach_px(template, warp),
            with_angle=self.models[k].with_angle,
            max_shift_px=self.shapes.shapes[k, 2],
        )

    def _start(self, image: GrayImage, k: int, aim: FloatArray) -> FloatArray:
        """State from which a fit starts at `aim`."""
        model = self.models[k]
        if np.isfinite(self.states[k, kernel.GAIN]):
            return np.concatenate([aim, self.states[k, 2:]])
        if model.source == "learned":
            return np.array([aim[0], aim[1], 0.0, 1.0, 0.0])
        return contrast_state(image, replace(model.detection, x_px=float(aim[0]), y_px=float(aim[1])))
