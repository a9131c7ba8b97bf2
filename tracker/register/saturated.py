"""Markers whose surroundings are at the white level, so that nothing is left to register."""

from __future__ import annotations

import numpy as np

from tracker.arrays import GrayImage
from tracker.markers import Detection

# Share of the pixels at the white level, and gray levels of the others relative to it, between which no edge is seen:
# an edge across a marker of 5 px fills a tenth of its surroundings with the gray levels between dark and white.
_MANY_WHITE, _ONE_LEVEL = 0.1, 0.05


def without_edges(images: list[GrayImage], detections: tuple[Detection, ...], white_level: float) -> str:
    """Reason why no marker can be registered where all have white pixels and one dark level only; empty else."""
    shares = []
    for found in detections:
        reach = found.size_px
        top, left = max(int(found.y_px - reach), 0), max(int(found.x_px - reach), 0)
        part = images[found.frame][top : int(found.y_px + reach) + 2, left : int(found.x_px + reach) + 2]
        below = part[part < white_level].astype(float)
        share = 1.0 - below.size / max(part.size, 1)
        levels = np.ptp(np.quantile(below, [0.02, 0.98])) if below.size else 0.0
        if share < _MANY_WHITE or levels > _ONE_LEVEL * white_level:
            return ""
        shares.append(share)
    if not shares:
        return ""
    white = f"the white level, {white_level:g}"
    return (
        f"markers were detected, but {100.0 * float(np.median(shares)):.0f} % of the pixels around them are at "
        f"{white}, and the others have one gray level: white pixels may be brighter than the file can state and are "
        f"not used, so no edge is left to register. Reduce exposure or light until white is below {white_level:g}; in "
        "a film that is drawn, use a darker white or edges with gray levels between"
    )
