"""Motion blur of a template, and the path of a marker during each exposure of the calibration frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tracker.arrays import ComplexArray, FloatArray
from tracker.template.spline import Template, crop_to_support, quadrature


@dataclass(frozen=True)
class Tuning:
    """Motion blur: when it is modelled, and how finely."""

    #: [px] shorter motion during the exposure is not modelled; step of the lengths in the bank of a first position
    #: physics: it changes the image less than the blur of lens and pixel does
    smallest_px: float = 0.5
    #: [nodes] of the quadrature along a path, at least
    least_nodes: int = 6
    #: [nodes/px] that are added for each px of the path
    #: convention: closer than the pixels
    nodes_a_px: float = 2.0
    #: [1] directions in that bank
    #: convention: steps of 7.5 degrees; a first position is fitted again along its path
    directions: int = 24
    #: [px] longest motion for which surroundings are kept
    #: convention: with a longer one a dot of ten px is a line
    longest_px: float = 40.0
    #: [1] squared contrast below which a detail counts as noise in deconvolution
    least_trace: float = 0.01
    #: [frames] sharp ones from which a template is learned, and others from which its chi-square is judged
    least_sharp: int = 12


TUNING = Tuning()


def exposed_path_px(motion_px: FloatArray, bend_px: FloatArray, exposure_share: float) -> FloatArray:
    """Path during the exposure: its straight part and its curvature, shape (2, 2).

    `motion_px` and `bend_px`, shape (2,), are the first and second derivative of the position by time in frames.

    Notes
    -----
    The marker is at ``path[0] s + path[1] (s^2 - 1/12) / 2`` from its mean position, s from -1/2 to 1/2. For a sinusoid
    of amplitude A and phase step p per frame, and with q = share p, the next term is a cubic of at most A q^3 / 240:
    odd like the straight part, it changes the length of the blur slightly and shifts nothing. The curvature must be
    included: the marker spends more time at the slow end of its path, which a symmetric blur would interpret as a shift
    of up to A q^2 / 12, the distance from the mean to the midpoint of the ends.
    """
    return np.stack([motion_px * exposure_share, bend_px * exposure_share**2])


def seen_from_marker(path: FloatArray, warp: FloatArray, angle_rad: float) -> FloatArray:
    """A path in px of the image, transformed to the marker's frame; shape (2, 2)."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(path @ (np.array([[cosine, sine], [-sine, cosine]]) @ warp).T)


def path_length_px(path: FloatArray) -> float:
    """Distance between the ends of a path, or its sagitta where that is longer."""
    return float(max(np.hypot(*path[0]), 0.125 * np.hypot(*path[1])))


def is_blur(length_px: float) -> bool:
    """Whether motion of this length during an exposure is modelled; not where it is NaN."""
    return bool(length_px >= TUNING.smallest_px)


def _on_path(path: FloatArray, s: FloatArray) -> FloatArray:
    """Positions on a path, shape (2, n)."""
    return np.asarray(path[0][:, None] * s + 0.5 * path[1][:, None] * (s * s - 1.0 / 12.0))


def _transfer(path: FloatArray, oversampling: float, size: tuple[int, ...]) -> ComplexArray:
    """Transfer function of a path for the real spectrum of an image of this size."""
    nodes, weights = quadrature(TUNING.least_nodes + int(np.ceil(TUNING.nodes_a_px * path_length_px(path))))
    places = _on_path(path, 0.5 * nodes) * oversampling
    down = np.exp(-2j * np.pi * np.outer(fft.fftfreq(size[0]), places[1]))
    across = np.exp(-2j * np.pi * np.outer(fft.rfftfreq(size[1]), places[0]))
    return np.asarray((down * (0.5 * weights)) @ across.T)


def unblurred(template: Template, paths_uv: list[FloatArray]) -> Template:
    """The image at rest, from the mean of images blurred along these paths.

    Wiener deconvolution of the mean blur. Paths of different lengths and directions preserve all details that the lens
    resolves, as long as the shortest are a px or two.
    """
    rows, cols = template.coefs.shape
    margin = 8 + int(2.0 * template.oversampling * max(path_length_px(p) for p in paths_uv))
    size = tuple(fft.next_fast_len(n + 2 * margin, real=True) for n in (rows, cols))
    after = [(margin, m - n - margin) for m, n in zip(size, (rows, cols), strict=True)]
    spectrum = fft.rfft2(np.pad(template.coefs, after, mode="edge"))
    mean = np.mean([_transfer(p, template.oversampling, size) for p in paths_uv], axis=0)
    inverse = np.conj(mean) * (1.0 + TUNING.least_trace) / (np.abs(mean) ** 2 + TUNING.least_trace)
    coefs = fft.irfft2(spectrum * inverse, s=size)[margin : margin + rows, margin : margin + cols]
    return Template(np.ascontiguousarray(coefs), template.support, template.oversampling)


def widened(template: Template, by_px: float) -> Template:
    """Template on a larger grid, extended with the values at its rim; the support is unchanged."""
    by = int(np.ceil(by_px * template.oversampling))
    return Template(
        np.pad(template.coefs, by, mode="edge"), np.pad(template.support, by), template.oversampling
    )


class Blurrer:
    """Creates blurred templates of one marker, exact for each path, from its template at rest.

    `known`, of the template's shape, marks grid points at which the image is known, including surroundings. Without it
    the image is extended with the values at the rim.
    """

    def __init__(self, template: Template, known: NDArray[np.uint8] | None = None) -> None:
        self._still = template
        self._own = template
        self._known = None if known is None else known > 0
        self._wide_px = 0.0 if known is None else np.inf
        self._spectrum: ComplexArray | None = None
        self._size: tuple[int, ...] = ()
        # The last support, and the path and grid it belongs to: shares of one path are tried with the same.
        self._last: tuple[tuple[bytes, tuple[int, ...]], NDArray[np.uint8]] | None = None

    def get(self, path_uv: FloatArray, support_of: FloatArray | None = None) -> Template:
        """Template for a path in px of the marker's frame; see `exposed_path_px`.

        Its support is the area that the marker's support passes over, as far as everything that passes there is known.
        """
        length = path_length_px(path_uv)
        if support_of is None and (length < TUNING.smallest_px or not np.isfinite(length)):
            return self._still
        if length > TUNING.longest_px:
            path_uv, length = path_uv * (TUNING.longest_px / length), TUNING.longest_px
        support_path = path_uv if support_of is None else support_of
        reach = min(path_length_px(support_path), TUNING.longest_px)
        spectrum = self._spectrum_for(max(length, reach) + 1.0)
        own, over = self._own, self._own.oversampling
        rows, cols = own.coefs.shape
        # The mean of shifted images is a product of spectra.
        coefs = fft.irfft2(spectrum * _transfer(path_uv, over, self._size), s=self._size)[:rows, :cols]
        key = (support_path.tobytes(), own.support.shape)
        if self._last is None or self._last[0] != key:
            self._last = key, self._support(support_path, reach)
        support = self._last[1]
        part = crop_to_support(support, 4)
        return Template(np.ascontiguousarray(coefs[part]), np.ascontiguousarray(support[part]), over)

    def _spectrum_for(self, by_px: float) -> ComplexArray:
        """Spectrum on a grid that includes all that a path of this length mixes into the marker."""
        if self._spectrum is None or by_px > self._wide_px:
            if by_px > self._wide_px:
                self._wide_px = 1.5 * by_px
                self._own = widened(self._still, self._wide_px)
            coefs = self._own.coefs
            self._size = tuple(fft.next_fast_len(n, real=True) for n in coefs.shape)
            after = [(0, m - n) for m, n in zip(self._size, coefs.shape, strict=True)]
            self._spectrum = fft.rfft2(np.pad(coefs, after, mode="edge"))
        return self._spectrum

    def _support(self, path: FloatArray, length: float) -> NDArray[np.uint8]:
        over = self._own.oversampling
        count = 2 + int(np.ceil(length * over / 2.0))
        steps = np.unique(np.rint(_on_path(path, np.linspace(-0.5, 0.5, count)) * over).astype(int), axis=1)
        rows, cols = self._own.support.shape
        passed, known = np.zeros((rows, cols), dtype=bool), np.ones((rows, cols), dtype=bool)
        # With a margin of False, a shift by whole grid points is a view.
        by = int(np.abs(steps).max())
        own_wide = np.pad(self._own.support > 0, by)
        known_wide = None if self._known is None else np.pad(self._known, by)
        for du, dv in steps.T:
            shifted = slice(by - dv, by - dv + rows), slice(by - du, by - du + cols)
            passed |= own_wide[shifted]
            if known_wide is not None:
                known &= known_wide[shifted]
        return (passed & known).astype(np.uint8)


class BlurBank:
    """Templates of one marker blurred along straight motion, created when first needed.

    Length is rounded to half a pixel and direction to 7.5 degrees: sufficient for a first position, from which the path
    is then determined.
    """

    def __init__(self, template: Template, known: NDArray[np.uint8] | None = None) -> None:
        self._exact = Blurrer(template, known)
        self._still = template
        self._made: dict[tuple[int, int], Template] = {}

    def get(self, motion_uv: FloatArray) -> Template:
        """Template for a straight motion during the exposure, a vector in px of the marker's frame."""
        length = float(np.hypot(motion_uv[0], motion_uv[1]))
        steps = round(min(length, TUNING.longest_px) / TUNING.smallest_px) if np.isfinite(length) else 0
        if length < TUNING.smallest_px or steps == 0:
            return self._still
        angle = np.arctan2(motion_uv[1], motion_uv[0]) % np.pi
        key = (steps, round(angle / np.pi * TUNING.directions) % TUNING.directions)
        if key not in self._made:
            direction = np.pi * key[1] / TUNING.directions
            vector = steps * TUNING.smallest_px * np.array([np.cos(direction), np.sin(direction)])
            self._made[key] = self._exact.get(np.stack([vector, np.zeros(2)]))
        return self._made[key]

    def exact(self, path_uv: FloatArray) -> Template:
        """Template for a path in px of the marker's frame; see `exposed_path_px`."""
        return self._exact.get(path_uv)


def extrapolated(past: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Next position by the polynomial through up to three positions, and the motion from frame to frame there."""
    last = past[-1]
    if len(past) == 1:
        return last, np.zeros(2)
    if len(past) == 2:
        return 2.0 * last - past[0], last - past[0]
    ahead = 3.0 * last - 3.0 * past[1] + past[0]
    return ahead, 0.5 * (ahead - past[1]) + (ahead - 2.0 * last + past[1])


def _motion(states: FloatArray) -> FloatArray:
    """Motion from frame to frame at each frame, by differences over four or two; 0 where a neighbour is missing."""
    motion = np.zeros((len(states), 2))
    if len(states) > 2:
        motion[1:-1] = 0.5 * (states[2:, :2] - states[:-2, :2])
        if len(states) > 4:
            wider = (4.0 * motion[2:-2] - 0.25 * (states[4:, :2] - states[:-4, :2])) / 3.0
            motion[2:-2] = np.where(np.isfinite(wider), wider, motion[2:-2])
        motion[0], motion[-1] = 2.0 * motion[1] - motion[2], 2.0 * motion[-2] - motion[-3]
    return np.where(np.isfinite(motion), motion, 0.0)


def _bend(states: FloatArray) -> FloatArray:
    """Second difference of the position at each frame; 0 where a neighbour is missing."""
    bend = np.zeros((len(states), 2))
    if len(states) > 2:
        bend[1:-1] = states[2:, :2] - 2.0 * states[1:-1, :2] + states[:-2, :2]
        bend[0], bend[-1] = bend[1], bend[-2]
    return np.where(np.isfinite(bend), bend, 0.0)


def path_derivatives_px(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motion from frame to frame and its change at each frame, both of shape (n, 2); 0 where unknown."""
    return _motion(states), _bend(states)


def paths_px(states: FloatArray, exposure_share: float) -> FloatArray:
    """Path during the exposure of each frame, shape (n, 2, 2); see `tracker.template.blur.exposed_path_px`."""
    motion, bend = path_derivatives_px(states)
    return np.array([exposed_path_px(m, b, exposure_share) for m, b in zip(motion, bend, strict=True)])


def sharp_states(states: FloatArray, exposure_share: float) -> FloatArray:
    """States without those of blurred frames, as long as there are enough sharp ones."""
    if exposure_share == 0.0:
        return states
    length = np.array([path_length_px(p) for p in paths_px(states, exposure_share)])
    seen = np.all(np.isfinite(states), axis=1)
    if not seen.any():
        return states
    enough = float(np.sort(length[seen])[min(TUNING.least_sharp, int(np.count_nonzero(seen))) - 1])
    return np.where((length <= max(enough, TUNING.smallest_px))[:, None], states, np.nan)


def typical_chi2(chi2: FloatArray, states: FloatArray, exposure_share: float) -> float:
    """Median of chi-square over frames that did not determine the template.

    A template learned from a dozen sharp frames contains their noise and fits them too well: the next sharpest frames
    are used where there are as many. Without blur the template is learned from many frames, and all are used.
    """
    fitted = np.isfinite(chi2)
    learned = np.all(np.isfinite(sharp_states(states, exposure_share)), axis=1) & fitted
    others = np.flatnonzero(fitted & ~learned)
    if others.size < TUNING.least_sharp:
        return float(np.nanmedian(chi2))
    length = np.array([path_length_px(p) for p in paths_px(states, exposure_share)])
    return float(np.median(chi2[others[np.argsort(length[others])[: 2 * TUNING.least_sharp]]]))
