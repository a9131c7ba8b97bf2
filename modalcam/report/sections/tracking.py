"""Tracking quality of one recording, marker by marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.format import MISSING, count, significant, thousands
from tracker.flags import REGISTRY
from tracker.results import MarkerTracks


@dataclass(frozen=True)
class MarkerRow:
    """One marker as the table shows it."""

    name: str
    reference: bool
    position: str
    found: str
    missing: str
    sd_x_px: str
    sd_y_px: str
    sd_mm: str
    flags: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class TrackingView:
    """Tracking quality: a row a marker, and facts on the footage and the scale."""

    rows: tuple[MarkerRow, ...]
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def tracking_view(tracks: MarkerTracks) -> TrackingView:
    """Everything about how well the markers were seen."""
    rows = tuple(_row(tracks, k) for k in range(len(tracks.markers)))
    return TrackingView(rows, _facts(tracks), tracks.notes)


def _row(tracks: MarkerTracks, k: int) -> MarkerRow:
    frames = tracks.frame.size
    found = int(np.count_nonzero(np.isfinite(tracks.x_px[:, k]) & np.isfinite(tracks.y_px[:, k])))
    scale = tracks.scale.mm_per_px if tracks.scale is not None else float("nan")
    sd = float(np.hypot(_median(tracks.sd_x_px[:, k]), _median(tracks.sd_y_px[:, k])) / np.sqrt(2.0))
    position = float(tracks.positions_mm[k])
    flags = tracks.flags[:, k]
    return MarkerRow(
        name=tracks.markers[k],
        reference=tracks.markers[k] in tracks.reference,
        position=MISSING if np.isnan(position) else f"{position:g}",
        found=f"{thousands(found)} of {thousands(frames)}",
        missing=f"{significant(100.0 * (frames - found) / frames, 2)} %" if frames else MISSING,
        sd_x_px=significant(_median(tracks.sd_x_px[:, k]), 2),
        sd_y_px=significant(_median(tracks.sd_y_px[:, k]), 2),
        sd_mm=significant(sd * scale, 2),
        flags=tuple(
            (flag.name, thousands(number))
            for flag in REGISTRY
            if (number := int(np.count_nonzero(flags & np.uint32(flag.value))))
        ),
    )


def _facts(tracks: MarkerTracks) -> tuple[tuple[str, str], ...]:
    decode, scale = tracks.decode, tracks.scale
    declared = thousands(decode.frames_declared) if decode.frames_declared else "not said"
    loss = "with losses" if decode.lossy else "without losses"
    return (
        (
            "Picture",
            f"{decode.width_px} × {decode.height_px} px, {decode.bit_depth} bit ({decode.pixel_format})",
        ),
        ("Codec", f"{decode.codec}, {loss}"),
        (
            "Frames",
            f"{thousands(decode.frames_decoded)} decoded, {declared} declared, {decode.frames_corrupt} damaged",
        ),
        (
            "Scale",
            "none: results in pixels"
            if scale is None
            else _scale(scale.mm_per_px, scale.sd_mm_per_px, scale.source),
        ),
        ("Markers", count(len(tracks.markers), "marker") + _references(tracks)),
    )


def _scale(mm_per_px: float, sd: float, source: str) -> str:
    relative = f" ± {significant(100.0 * sd / mm_per_px, 2)} %" if np.isfinite(sd) and sd > 0.0 else ""
    return f"{significant(mm_per_px, 5)} mm/px{relative} ({source})"


def _references(tracks: MarkerTracks) -> str:
    number = sum(name in tracks.reference for name in tracks.markers)
    return f", {number} of them fixed and subtracted" if number else ""


def _median(values: NDArray[np.float64]) -> float:
    good = values[np.isfinite(values)]
    return float(np.median(good)) if good.size else float("nan")
