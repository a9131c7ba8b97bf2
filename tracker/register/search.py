"""Coarse search for a marker's template in a window, when the prediction has missed it."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.template import Template

# Normalised correlation at the best whole pixel below which nothing was found.
_LEAST_SCORE = 0.6


def coarse_search(
    image: GrayImage,
    centre_px: FloatArray,
    reach_px: float,
    template: Template,
    warp: FloatArray,
    gain: float,
) -> FloatArray | None:
    """Whole-pixel position of the best normalised correlation with a template, or None.

    The marker's centre is sought within `reach_px` of `centre_px` in x and y. Only the sign of `gain` is used: with a
    negative gain the negative of the template is searched for.
    """
    half = int(np.ceil(template.reach_px / np.linalg.svd(warp, compute_uv=False)[-1] / np.sqrt(2.0))) + 1
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    pattern, support = template.sampled(np.einsum("ij,jrc->irc", warp, np.stack([u, v])))
    height, width = image.shape
    x, y = round(float(centre_px[0])), round(float(centre_px[1]))
    span = half + int(np.ceil(reach_px))
    top, left = max(y - span, 0), max(x - span, 0)
    part = image[top : min(y + span + 1, height), left : min(x + span + 1, width)].astype(np.float32)
    if part.shape[0] < pattern.shape[0] or part.shape[1] < pattern.shape[1]:
        return None
    signed = (np.sign(gain) * pattern).astype(np.float32)
    score = cv2.matchTemplate(part, signed, cv2.TM_CCOEFF_NORMED, mask=support.astype(np.float32))
    score[~np.isfinite(score)] = -1.0
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    if score[best] < _LEAST_SCORE:
        return None
    return np.array([left + best[1] + half, top + best[0] + half], dtype=np.float64)
