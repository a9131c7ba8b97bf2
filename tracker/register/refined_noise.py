"""Camera noise estimated again from the residuals of markers that their ideal template explains."""

from __future__ import annotations

import numpy as np

from tracker.arrays import GrayImage
from tracker.register.marker import MarkerModel
from tracker.template import (
    LEAST_IN_BIN,
    Blurrer,
    NoiseModel,
    fit_line,
    modelled_pixels,
    paths_px,
    seen_from_marker,
    sharp_states,
)

BINS = 12
FRAMES = 24
# Range of chi-square under the first noise model within which a marker's template can be correct.
PLAUSIBLE_CHI2 = (0.2, 1.6)


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
    width = max((high - low) / BINS, 1e-9)
    sums = np.zeros((3, BINS))
    fits = 0
    for model in good:
        seen = np.flatnonzero(np.all(np.isfinite(sharp_states(model.states, exposure_share)), axis=1))
        paths = paths_px(model.states, exposure_share)
        blurrer = Blurrer(model.template, model.known)
        for k in seen[:: max(1, seen.size // FRAMES)]:
            state = model.states[k]
            template = blurrer.get(seen_from_marker(paths[k], model.warp, state[2]))
            at, pixel, level = modelled_pixels(
                frames[k], state, model.warp, template.coefs, template.oversampling
            )
            inside = template.support[at] > 0
            pixel, level = pixel[inside], level[inside]
            index = np.clip(((level - low) / width).astype(np.int64), 0, BINS - 1)
            for total, amount in zip(sums, (np.ones(level.size), level, (pixel - level) ** 2), strict=True):
                np.add.at(total, index, amount)
            fits += 1
    used = sums[0] >= LEAST_IN_BIN
    if not used.any():
        return first
    # Each fit determined x, y, angle, gain and offset from its pixels.
    pixels = float(sums[0].sum())
    correction = pixels / max(pixels - 5.0 * fits, 0.5 * pixels)
    count, level, square = sums[:, used]
    return fit_line(level / count, correction * square / count, count)
