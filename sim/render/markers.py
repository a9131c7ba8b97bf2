"""Markers and random surface patterns: their images through the lens.

The image of a marker is a finely sampled table; that of a pattern is known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import i0e, ndtr

from sim.render.kernels import TUNING as KERNELS
from tracker import FloatArray, checked


@dataclass(frozen=True)
class Tuning:
    """Accuracy of the tables."""

    #: [per sd] samples of a marker's image per standard deviation of the blur
    #: physics: Cubic interpolation is exact to 0.0234 h^4 f'''' with f'''' = 0.55 / sigma^4: 6e-7 of the contrast.
    samples: int = 12
    #: [per grain] samples of a texture per correlation length
    #: physics: Cubic interpolation is exact to 0.0234 h^4 3 / g^4: 2e-5 of the sd.
    grain_samples: int = 8
    #: [1] waves in a texture
    #: convention: Enough for a nearly normal distribution of gray levels: the excess kurtosis is -1.5 / 96.
    waves: int = 96


TUNING = Tuning()


@dataclass(frozen=True)
class MarkerTable:
    """Image of a marker through the lens in its own axes, minus the camera's background.

    Attributes
    ----------
    values : array, shape (n, n)
        Counts above the background; row 0 is the top of the marker. Zero outside.
    step_px : float
        Distance of samples; sample ((n - 1)/2, (n - 1)/2) is the centre.
    """

    values: FloatArray
    step_px: float

    @property
    def half_px(self) -> float:
        """Half the side of the table."""
        return 0.5 * float(self.values.shape[0] - 1) * self.step_px


class Marker(Protocol):
    """A marker that can be rendered."""

    @property
    def half_extent_mm(self) -> float:
        """From the centre to the edge, along the beam."""
        ...

    def table(self, *, mm_per_px: float, lens_blur_px: float, background: float) -> MarkerTable:
        """Image through the lens, minus the background."""
        ...


@dataclass(frozen=True, kw_only=True)
class DotMarker:
    """A round dot of `foreground` counts, on a round patch of its own or directly on the camera's background.

    Attributes
    ----------
    background : float or None
        Counts of the patch around the dot; None uses the camera's background.
    quiet_zone_mm : float
        Width of the patch around the dot.
    """

    diameter_mm: float
    foreground: float = 30.0
    background: float | None = None
    quiet_zone_mm: float = 0.0

    def __post_init__(self) -> None:
        checked("diameter_mm", self.diameter_mm, positive=True)
        checked("quiet_zone_mm", self.quiet_zone_mm, at_least=0.0)

    @property
    def half_extent_mm(self) -> float:
        """Radius of the patch, or of the dot without one."""
        return 0.5 * self.diameter_mm + (self.quiet_zone_mm if self.background is not None else 0.0)

    def table(self, *, mm_per_px: float, lens_blur_px: float, background: float) -> MarkerTable:
        """Image through the lens, minus the background."""
        offset, step = _grid(self.half_extent_mm / mm_per_px, lens_blur_px)
        radius = np.hypot(offset[:, None], offset[None, :])
        patch = background if self.background is None else self.background
        dot_px = 0.5 * self.diameter_mm / mm_per_px
        values = (self.foreground - patch) * blurred_disc(radius, dot_px, lens_blur_px)
        if patch != background:
            values += (patch - background) * blurred_disc(
                radius, self.half_extent_mm / mm_per_px, lens_blur_px
            )
        return MarkerTable(values, step)


@dataclass(frozen=True, kw_only=True)
class ArucoMarker:
    """An ArUco marker of a predefined OpenCV dictionary, such as "DICT_4X4_50", with its quiet zone.

    Attributes
    ----------
    size_mm, quiet_zone_mm : float
        Side of the black square, border included, and white margin on every side.
    foreground, background : float
        Counts of the black and the white cells.

    Raises
    ------
    ValueError
        If the dictionary does not exist or has no such id, or a size is not positive.
    """

    dictionary: str
    marker_id: int
    size_mm: float
    quiet_zone_mm: float = 2.0
    foreground: float = 30.0
    background: float = 200.0

    def __post_init__(self) -> None:
        checked("size_mm", self.size_mm, positive=True)
        checked("quiet_zone_mm", self.quiet_zone_mm, at_least=0.0)
        aruco_cells(self.dictionary, self.marker_id)

    @property
    def half_extent_mm(self) -> float:
        """From the centre to the edge of the quiet zone."""
        return 0.5 * self.size_mm + self.quiet_zone_mm

    def table(self, *, mm_per_px: float, lens_blur_px: float, background: float) -> MarkerTable:
        """Image through the lens, minus the background."""
        offset, step = _grid(self.half_extent_mm / mm_per_px, lens_blur_px)
        white = aruco_cells(self.dictionary, self.marker_id)
        size, quiet = self.size_mm / mm_per_px, self.quiet_zone_mm / mm_per_px
        edges = np.linspace(-0.5 * size, 0.5 * size, white.shape[0] + 1)
        edges = np.concatenate([[edges[0] - quiet], edges, [edges[-1] + quiet]])
        levels = (
            np.where(np.pad(white, 1, constant_values=True), self.background, self.foreground) - background
        )
        # a Gaussian is separable in any axes, so each cell is a product of edges in the marker's own axes
        cumulative = ndtr((offset[:, None] - edges[None, :]) / lens_blur_px)
        share = cumulative[:, :-1] - cumulative[:, 1:]
        return MarkerTable(share @ levels @ share.T, step)


def aruco_cells(dictionary: str, marker_id: int) -> NDArray[np.bool_]:
    """White cells of a marker with its black border, shape (n + 2, n + 2), row 0 at the top.

    Raises
    ------
    ValueError
        If the dictionary does not exist or has no such id.
    """
    constant = getattr(cv2.aruco, dictionary, None) if dictionary.startswith("DICT_") else None
    if constant is None:
        msg = f"no predefined ArUco dictionary is called {dictionary!r}; DICT_4X4_50 is one"
        raise ValueError(msg)
    codes = cv2.aruco.getPredefinedDictionary(constant)
    count = int(codes.bytesList.shape[0])
    if not 0 <= marker_id < count:
        msg = f"{dictionary} has ids 0 to {count - 1}, got {marker_id}"
        raise ValueError(msg)
    image = cv2.aruco.generateImageMarker(codes, marker_id, codes.markerSize + 2)
    return np.asarray(image > 127, dtype=np.bool_)


def blurred_disc(radius_px: FloatArray, disc_px: float, sigma_px: float) -> FloatArray:
    """Disc of height 1 and radius `disc_px` convolved with a Gaussian, at distances from its centre, to about 1e-9.

    Notes
    -----
    ``g(r) = int_0^R rho / s^2 exp(-(r^2 + rho^2) / 2 s^2) I_0(r rho / s^2) d rho`` (the Rice distribution), over
    the part of (0, R) within 9 s of r, by 48 Gauss-Legendre points: the integrand is a bump of width s there.
    On a fine radial line, then by cubic spline.
    """
    line = np.arange(0.0, float(np.max(radius_px)) + sigma_px, sigma_px / 40.0)
    nodes, weights = np.polynomial.legendre.leggauss(48)
    low = np.clip(line - 9.0 * sigma_px, 0.0, disc_px)
    high = np.clip(line + 9.0 * sigma_px, 0.0, disc_px)
    rho = 0.5 * (high + low)[:, None] + 0.5 * (high - low)[:, None] * nodes
    density = (
        rho
        / sigma_px**2
        * np.exp(-0.5 * ((rho - line[:, None]) / sigma_px) ** 2)
        * i0e(rho * line[:, None] / sigma_px**2)
    )
    profile = 0.5 * (high - low) * (density @ weights)
    return np.asarray(CubicSpline(line, profile)(radius_px), dtype=np.float64)


def _grid(half_px: float, sigma_px: float) -> tuple[FloatArray, float]:
    step = sigma_px / TUNING.samples
    n = int(np.ceil((half_px + KERNELS.reach * sigma_px) / step))
    return np.arange(-n, n + 1, dtype=np.float64) * step, step


@dataclass(frozen=True, kw_only=True)
class Texture:
    """Random pattern of gray levels with mean 0, the same for the same seed.

    Attributes
    ----------
    sd : float
        Standard deviation in counts.
    grain_mm : float
        Correlation length g: the correlation at distance r is ``exp(-r^2 / (2 g^2))``.
    seed : int

    Notes
    -----
    A sum of waves with random directions, lengths and phases and equal amplitudes (Rahimi and Recht, Random features
    for large-scale kernel machines, 2007). A Gaussian point spread function multiplies each wave by a number.
    """

    sd: float
    grain_mm: float
    seed: int = 0

    def __post_init__(self) -> None:
        checked("sd of a texture", self.sd, at_least=0.0)
        checked("grain_mm of a texture", self.grain_mm, positive=True)

    @property
    def step_mm(self) -> float:
        """Distance of samples between which cubic interpolation is exact to ``0.0234 h^4 3 / g^4``: 2e-5 of `sd`."""
        return self.grain_mm / TUNING.grain_samples

    def on_grid(
        self, x_mm: FloatArray, y_mm: FloatArray, *, box_mm: float = 0.0, blur_mm: float = 0.0
    ) -> FloatArray:
        """Counts at all pairs of `x_mm`, (c,), and `y_mm`, (r,), shape (r, c).

        Averaged over a square of the side `box_mm` and blurred by a Gaussian of the standard deviation `blur_mm`.
        """
        rng, waves = np.random.default_rng(self.seed), TUNING.waves
        # an even spread of wave lengths, whatever the seed
        radius = np.sqrt(-2.0 * np.log((np.arange(waves) + 0.5) / waves)) / self.grain_mm
        direction = np.pi * (np.arange(waves) * (np.sqrt(5.0) - 1.0) + rng.uniform())
        phase = rng.uniform(0.0, 2.0 * np.pi, waves)
        kx, ky = radius * np.cos(direction), radius * np.sin(direction)
        amplitude = self.sd * np.sqrt(2.0 / waves) * np.exp(-0.5 * (blur_mm * radius) ** 2)
        amplitude *= np.sinc(kx * box_mm / (2.0 * np.pi)) * np.sinc(ky * box_mm / (2.0 * np.pi))
        along_y = np.asarray(y_mm)[:, None] * ky
        along_x = np.asarray(x_mm)[:, None] * kx + phase
        return np.asarray(
            (np.cos(along_y) * amplitude) @ np.cos(along_x).T
            - (np.sin(along_y) * amplitude) @ np.sin(along_x).T
        )
