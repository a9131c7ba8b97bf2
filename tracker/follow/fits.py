"""Registration of single markers, starting from their last good state.

`RowStore` holds the results of all frames while the length of the recording is not yet known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import FlagArray, FloatArray, GrayImage, IntArray
from tracker.follow.batch import LIMITS, LastSeen, MarkerArrays
from tracker.markers import FrameResult
from tracker.register import Camera, MarkerModel, acceptable, contrast_state, kernel, register
from tracker.template import BlurBank, Template, is_blur, seen_from_marker


@dataclass(frozen=True)
class Tuning:
    """Registration of single markers."""

    #: [frames] of an array of results
    #: convention: enough that few arrays are needed, few enough that an unfinished one costs little memory
    chunk_rows: int = 1024
    #: [px] from the prediction at which a fit fails
    shift_px: float = 4.0
    #: [1] of the marker's size that is added
    shift_share: float = 0.2


TUNING = Tuning()


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


class RowStore:
    """Results of m markers frame by frame: 36 m bytes per row, without an object for each."""

    def __init__(self, markers: int) -> None:
        self._markers = markers
        self._values: list[FloatArray] = []
        self._correlation: list[FloatArray] = []
        self._flags: list[FlagArray] = []
        self._count = 0

    def append(self, result: FrameResult) -> None:
        """Copy the result of a frame."""
        row = self._count % TUNING.chunk_rows
        if row == 0:
            self._values.append(np.empty((4, TUNING.chunk_rows, self._markers)))
            if result.correlation is not None:
                self._correlation.append(np.empty((TUNING.chunk_rows, self._markers)))
            self._flags.append(np.empty((TUNING.chunk_rows, self._markers), dtype=np.uint32))
        self._values[-1][:, row] = result.out
        self._flags[-1][row] = result.marks
        if result.correlation is not None:
            self._correlation[-1][row] = result.correlation
        self._count += 1

    def columns(self, order: IntArray) -> tuple[FloatArray, FlagArray, FloatArray | None]:
        """`FrameResult.out`, shape (4, n, m), flags and correlations, (n, m), with the rows in the given order."""
        no_flags = np.empty((0, self._markers), dtype=np.uint32)
        values = np.concatenate(self._values or [np.empty((4, 0, self._markers))], axis=1)[:, order]
        correlation = np.concatenate(self._correlation)[order] if self._correlation else None
        return values, np.concatenate([no_flags, *self._flags])[order], correlation
