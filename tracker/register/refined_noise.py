"""Camera noise estimated again from the residuals of markers that their ideal template explains."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.register.marker import MarkerModel
from tracker.template.blur import Blurrer, seen_from_marker
from tracker.template.noise import LEAST_IN_BIN, NoiseModel, fit_line
from tracker.template.paths import paths_px, sharp_states
from tracker.template.spline_kernels import fill_taps, placed, spline_value

BINS = 12
FRAMES = 24
# Range of chi-square under the first noise model within which a marker's template can be correct.
PLAUSIBLE_CHI2 = (0.2, 1.6)


@njit(cache=True, nogil=True)
def _sum_by_level(
    image: GrayImage,
    state: FloatArray,
    warp: FloatArray,
    coefs: FloatArray,
    support: NDArray[np.uint8],
    oversampling: float,
    low: float,
    width: float,
    sums: FloatArray,
) -> None:
    """Add count, intensity and squared residual of each pixel to the bin of its modelled intensity."""
    rows, cols = coefs.shape
    a00, a01, a10, a11, u0, v0, half_x, half_y = placed(state, warp, oversampling, rows, cols)
    wu = np.empty(4)
    wv = np.empty(4)
    for j in range(max(int(state[1] - half_y), 0), min(int(state[1] + half_y) + 2, image.shape[0])):
        for i in range(max(int(state[0] - half_x), 0), min(int(state[0] + half_x) + 2, image.shape[1])):
            px, py = i - state[0], j - state[1]
            gu = a00 * px + a01 * py + u0
            gv = a10 * px + a11 * py + v0
            iu, iv = int(np.floor(gu)), int(np.floor(gv))
            if iu < 1 or iv < 1 or iu > cols - 3 or iv > rows - 3:
                continue
            if support[int(gv + 0.5), int(gu + 0.5)] == 0:
                continue
            fill_taps(gu - iu, wu)
            fill_taps(gv - iv, wv)
            model = state[3] * spline_value(coefs, iu, iv, wu, wv) + state[4]
            k = min(max(int((model - low) / width), 0), sums.shape[0] - 1)
            sums[k, 0] += 1.0
            sums[k, 1] += model
            sums[k, 2] += (image[j, i] - model) ** 2


def refined_noise(
    frames: list[GrayImage], models: tuple[MarkerModel, ...], first: NoiseModel, exposure_share: float = 0.0
) -> NoiseModel:
    """Noise model from the residuals of markers whose parametric template fits.

    Small markers contain no smooth areas, so their brightness can be missing in an estimate from differences of
    frames; the residuals include it. The first model is returned where no marker fits well enough for its residuals to
    be noise.
    """
    low_chi2, high_chi2 = PLAUSIBLE_CHI2
    good = [m for m in models if m.source == "parametric" and low_chi2 < m.chi2 < high_chi2]
    if not good:
        return first
    gain = np.nanmedian([np.nanmedian(m.states[:, 3]) for m in good])
    offset = np.nanmedian([np.nanmedian(m.states[:, 4]) for m in good])
    low, high = sorted((float(offset), float(offset + gain)))
    sums = np.zeros((BINS, 3))
    fits = 0
    for model in good:
        seen = np.flatnonzero(np.all(np.isfinite(sharp_states(model.states, exposure_share)), axis=1))
        paths = paths_px(model.states, exposure_share)
        blurrer = Blurrer(model.template, model.known)
        for k in seen[:: max(1, seen.size // FRAMES)]:
            template = blurrer.get(seen_from_marker(paths[k], model.warp, model.states[k, 2]))
            _sum_by_level(
                frames[k],
                model.states[k],
                model.warp,
                template.coefs,
                template.support,
                template.oversampling,
                low,
                max((high - low) / BINS, 1e-9),
                sums,
            )
            fits += 1
    used = sums[:, 0] >= LEAST_IN_BIN
    if not used.any():
        return first
    # Each fit determined x, y, angle, gain and offset from its pixels.
    pixels = float(sums[:, 0].sum())
    correction = pixels / max(pixels - 5.0 * fits, 0.5 * pixels)
    count, level, square = sums[used].T
    return fit_line(level / count, correction * square / count, count)
