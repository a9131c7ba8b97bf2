"""The image of a bare strip in front of a still background."""

from __future__ import annotations

from math import ceil

import numpy as np

from sim.render.camera import Camera
from sim.render.kernels import REACH
from sim.render.motion import Poses
from sim.render.quadrature import panels
from sim.render.strip.bare_strip import BareStrip, visible_parts
from sim.render.strip.strip_kernels import add_strip_points
from sim.render.texture import Texture
from tracker import FloatArray


class StripImage:
    """Draws a bare strip into frames of a camera.

    ``I(p) = int int (b(s, t) - B(x)) P(p - x) |dx/d(s, t)| ds dt`` over the strip, with x its point at distance s along
    and t across, b its brightness, B that of the background and P the point spread function averaged over a pixel, by
    Gauss-Legendre points in s and t.
    """

    def __init__(self, strip: BareStrip, camera: Camera, backdrop: Texture | None) -> None:
        self._strip, self._camera = strip, camera
        scale, sigma = camera.mm_per_px, camera.lens_blur_px
        self._surface, grid = strip.surface.table(float(strip.arc_mm[-1]), strip.width_mm)
        # across in px, along in mm
        self._surface_grid = (grid[0] / scale, grid[1] * scale, grid[2], grid[3])
        self._backdrop, self._backdrop_grid = self._behind(backdrop)
        half = 0.5 * strip.width_mm / scale
        at, weights = panels(-half, half, strip.surface.narrowest(sigma * scale) / scale)
        self._across = np.column_stack([at, weights])

    def _behind(self, backdrop: Texture | None) -> tuple[FloatArray, tuple[float, float, float, float]]:
        """Texture of the frame and of what blurs into it, and its grid in px."""
        if backdrop is None:
            return np.zeros((0, 0)), (0.0, 0.0, 0.0, 0.0)
        camera = self._camera
        step = backdrop.step_mm / camera.mm_per_px
        before = 0.5 + REACH * camera.lens_blur_px + 3.0 * step
        rows, columns = (
            np.asarray(np.arange(ceil((side + 2.0 * before) / step) + 1) * step - before, dtype=np.float64)
            for side in (camera.height_px, camera.width_px)
        )
        values = backdrop.on_grid(*camera.to_mm(columns, rows))
        return values, (-before, 1.0 / step, -before, 1.0 / step)

    def add(self, image: FloatArray, points: Poses, covers: FloatArray, share: float) -> None:
        """Add `share` of the difference between strip and background to an image of the background.

        Parameters
        ----------
        points : Poses
            Of the strip's motion at one instant.
        covers : array, shape (m, 3)
            Circles x, y, radius in px that hide the strip.
        """
        camera, strip = self._camera, self._strip
        scale, sigma = camera.mm_per_px, camera.lens_blur_px
        curve = strip.curve(points)
        covers_mm = np.column_stack([*camera.to_mm(covers[:, 0], covers[:, 1]), scale * covers[:, 2]])
        for part in visible_parts(curve, covers_mm, scale):
            arc, weights = panels(*part, sigma * scale)
            at = strip.geometry(curve, arc)
            x, y = camera.to_px(at[:, 0], at[:, 1])
            length_px = share * weights * at[:, 5] / scale
            add_strip_points(
                image,
                np.column_stack([x, y, at[:, 2], -at[:, 3], at[:, 4] * scale, arc, length_px]),
                self._across,
                self._surface,
                self._surface_grid,
                self._backdrop,
                self._backdrop_grid,
                float(camera.background),
                sigma,
            )
