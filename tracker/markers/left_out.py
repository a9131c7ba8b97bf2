"""Regions of the picture in which no marker is sought: they are filled from their edges before detection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.base import (
    Candidates,
    Detection,
    FoundMarkers,
    LookAlikeDetector,
    MarkerDetector,
    NothingFound,
)

# Two opposite corners, in px.
Region = Sequence[Sequence[float]]


def leaving_out(detector: MarkerDetector, regions: Sequence[Region]) -> MarkerDetector:
    """Detector that finds nothing in these regions, neither at first nor when a marker is lost."""
    if not regions:
        return detector
    return (
        _LookAlikes(detector, regions)
        if isinstance(detector, LookAlikeDetector)
        else _Other(detector, regions)
    )


def filled(image: GrayImage, regions: Sequence[Region]) -> GrayImage:
    """Copy of an image whose regions continue the gray levels around them, without an edge of their own."""
    out = image.copy()
    for region in regions:
        (left, top), (right, bottom) = np.sort(np.rint(np.asarray(region, dtype=float)), axis=0).astype(int)
        rows = slice(max(top, 0), min(bottom + 1, image.shape[0]))
        columns = slice(max(left, 0), min(right + 1, image.shape[1]))
        if rows.start < rows.stop and columns.start < columns.stop:
            out[rows, columns] = _continued(out, rows, columns)
    return out


def _continued(image: GrayImage, rows: slice, columns: slice) -> FloatArray:
    """Mean of what the pixels to the left and right, and those above and below, give for each pixel of a region."""
    across = _between(image[rows], columns)
    along = _between(image[:, columns].T, rows)
    known = [part for part in (across, None if along is None else along.T) if part is not None]
    return np.asarray(np.rint(np.mean(known, axis=0)) if known else np.median(image))


def _between(lines: GrayImage, part: slice) -> FloatArray | None:
    """Values of each line between the pixels before and after a part of it; None where there is neither."""
    before = lines[:, part.start - 1].astype(float) if part.start > 0 else None
    after = lines[:, part.stop].astype(float) if part.stop < lines.shape[1] else None
    if before is None or after is None:
        one = before if after is None else after
        return None if one is None else np.repeat(one[:, None], part.stop - part.start, axis=1)
    share = np.arange(1, part.stop - part.start + 1) / (part.stop - part.start + 1)
    return np.asarray(before[:, None] + share * (after - before)[:, None])


class _Other:
    """Detector of markers that are told from each other, without the regions."""

    def __init__(self, detector: MarkerDetector, regions: Sequence[Region]) -> None:
        self._detector = detector
        self._regions = regions

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        height, width = frames[0].shape
        for region in self._regions:
            (left, top), (right, bottom) = np.sort(np.asarray(region, dtype=float), axis=0)
            if right < 0.0 or bottom < 0.0 or left > width - 1 or top > height - 1:
                return NothingFound(
                    f"the region of leave_out_px from ({left:g}, {top:g}) to ({right:g}, {bottom:g}) lies outside the "
                    f"image of {width} x {height} px"
                )
        return self._detector.detect([filled(frame, self._regions) for frame in frames])

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        return self._detector.redetect(filled(image, self._regions), sought)


class _LookAlikes(_Other):
    """The same for markers that cannot be told from each other."""

    def candidates(self, image: GrayImage, sought: tuple[Detection, ...]) -> Candidates:
        detector = cast("LookAlikeDetector", self._detector)
        return detector.candidates(filled(image, self._regions), sought)
