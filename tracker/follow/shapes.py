"""How the markers' templates lie in the picture."""

from __future__ import annotations

import numpy as np

from tracker.arrays import FloatArray
from tracker.follow.batch import LIMITS
from tracker.register.marker import MarkerModel, reach_px, stride


class Shapes:
    """Templates and warps of m markers, as the compiled calls take them.

    Attributes
    ----------
    coefs, support : array
        Of all templates, one behind the other.
    places : int array, shape (m, 5)
        Where a template begins, its rows and columns, its stride, and whether its angle is fitted.
    warps : array, shape (m, 2, 2)
    shapes : array, shape (m, 3)
        Oversampling, reach and largest shift in pixels.
    centres_uv : array, shape (m, 2)
    limits : array, shape (m, LIMITS)
    """

    def __init__(self, models: tuple[MarkerModel, ...]) -> None:
        self._templates = [m.template for m in models]
        self._largest_shift = [4.0 + 0.2 * m.detection.size_px for m in models]
        grids = [t.grid for t in self._templates]
        self.coefs = np.concatenate([coefs.ravel() for coefs, _ in grids])
        self.support = np.concatenate([support.ravel() for _, support in grids])
        sizes = [support.size for _, support in grids]
        first = np.concatenate([[0], np.cumsum(sizes[:-1])])
        self.places = np.array(
            [
                (f, *support.shape, 1, m.with_angle)
                for f, m, (_, support) in zip(first, models, grids, strict=True)
            ],
            dtype=np.int64,
        )
        self.warps = np.array([m.warp for m in models])
        self.shapes = np.zeros((len(models), 3))
        for k, model in enumerate(models):
            self.set_warp(k, model.warp)
        self.centres_uv = np.array([m.centre_uv for m in models])
        usual = [max(1.0, m.chi2) if np.isfinite(m.chi2) else 1.0 for m in models]
        self.limits = np.array(
            [
                (u, m.detection.size_px, m.detection.kind == "aruco")
                for u, m in zip(usual, models, strict=True)
            ],
            dtype=np.float64,
        ).reshape(-1, LIMITS)

    def set_warp(self, k: int, warp: FloatArray) -> None:
        """Let marker k look otherwise from now on."""
        template = self._templates[k]
        self.warps[k] = warp
        self.places[k, 3] = stride(template, warp)
        self.shapes[k] = template.oversampling, reach_px(template, warp), self._largest_shift[k]
