"""Spots that look like a known one, searched for in single frames: a few gray levels only, and fast."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.arrays import FloatArray, GrayImage

# Blur widens a spot along its path and lowers its contrast: limits relative to the diameter and area at rest.
LEAST_WIDTH, MOST_WIDTH = 0.6, 3.0
LEAST_AREA, MOST_AREA = 0.4, 3.0
# A disc fills 79 % of its bounding box.
LEAST_FILLED = 0.6
# Spots of different levels are the same within this share of the diameter.
SAME = 0.4


def gray_level(image: GrayImage, centre_px: FloatArray, diameter_px: float) -> float:
    """Gray level midway between a spot inside the image and its surroundings."""
    half = int(np.ceil(0.5 * diameter_px)) + 2
    x, y = round(float(centre_px[0])), round(float(centre_px[1]))
    top, left = max(y - half, 0), max(x - half, 0)
    part = image[top : y + half + 1, left : x + half + 1].astype(np.float64)
    rows, columns = np.indices(part.shape)
    distance = np.hypot(columns + left - centre_px[0], rows + top - centre_px[1])
    inside, outside = part[distance < 0.25 * diameter_px + 0.5], part[distance > 0.5 * diameter_px + 1.0]
    return 0.5 * float(np.median(inside) + np.median(outside))


def similar_spots(image: GrayImage, diameter_px: float, levels: FloatArray, *, light: bool) -> FloatArray:
    """Centres of regions of about this diameter, lighter (or darker) than one of the levels; shape (s, 2)."""
    found: list[FloatArray] = []
    for level in levels:
        mask = ((image > level) if light else (image < level)).astype(np.uint8)
        _, _, table, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
        width, height, area = (table[:, c].astype(np.float64) for c in (2, 3, 4))
        ratio = area / (0.25 * np.pi * diameter_px**2)
        good = (np.minimum(width, height) > LEAST_WIDTH * diameter_px) & (ratio > LEAST_AREA)
        good &= (np.maximum(width, height) < MOST_WIDTH * diameter_px) & (ratio < MOST_AREA)
        good &= area > LEAST_FILLED * width * height
        # The first component is the rest of the image.
        for centre in np.asarray(centres, dtype=np.float64)[1:][good[1:]]:
            if all(np.hypot(*(centre - other)) > SAME * diameter_px for other in found):
                found.append(centre)
    return np.array(found).reshape(-1, 2)
