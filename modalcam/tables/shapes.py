"""`shapes.csv`: mode shapes along the beam and their curvature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from modal_id import IdentifiedMode
from modal_id.modes import Curvature, beam_curvature, in_phase
from modalcam.pipeline import BeamResult, RecordingResult, RunResult
from modalcam.tables.columns import SHAPE_COLUMNS
from modalcam.tables.csv_files import table_writer
from tracker import ComplexArray, Failure, FloatArray, MarkerTracks, table_row


@dataclass(frozen=True)
class ShapePoint:
    """A mode of a recording at one marker; curvature NaN where there is none."""

    recording: str
    mode: IdentifiedMode
    marker: str
    position_mm: float
    shape: complex
    shape_sd: float
    curvature_1_m2: float
    curvature_sd_1_m2: float


def unit_shape(mode: IdentifiedMode) -> ComplexArray:
    """Shape with a largest modulus of 1, rotated so that the sum of squares of its imaginary part is smallest."""
    return in_phase(mode.shape) / mode.amplitude


def curvature(
    recording: RecordingResult, mode: IdentifiedMode, beam: BeamResult | None, at_mm: FloatArray | None = None
) -> Curvature | Failure:
    """Curvature of `unit_shape` in 1/m^2, at the markers or at other distances from the clamp.

    Relative to an amplitude: times that of the mode in m, it is the curvature of the beam in 1/m.
    """
    identified, tracks = recording.identified, recording.tracks
    if identified is None or beam is None:
        return Failure("the free length of the beam is unknown: give it in [beam]")
    if not beam.standard.cantilever:
        return Failure(
            f"curvatures are known for a clamped and a free end only, not for {beam.standard.ends}"
        )
    return beam_curvature(
        identified.series.positions_mm,
        unit_shape(mode),
        mode.shape_sd / mode.amplitude,
        1e3 * beam.standard.length_m,
        at_mm,
        tracks.ends_sd_mm if isinstance(tracks, MarkerTracks) else None,
    )


def shape_rows(result: RunResult) -> Iterator[dict[str, Any]]:
    """One row for each mode and marker of known position; NaN where there is no curvature."""
    for recording in result.recordings:
        if recording.identified is None:
            continue
        series = recording.identified.series
        for mode in recording.identified.modes:
            shape, found = unit_shape(mode), curvature(recording, mode, result.beam)
            unknown = np.full(shape.size, np.nan)
            value, sd = (unknown, unknown) if isinstance(found, Failure) else (found.value, found.sd)
            for k in np.flatnonzero(np.isfinite(series.positions_mm) & np.isfinite(shape)):
                point = ShapePoint(
                    recording.name,
                    mode,
                    series.channels[k],
                    series.positions_mm[k],
                    shape[k],
                    mode.shape_sd[k] / mode.amplitude,
                    value[k],
                    sd[k],
                )
                yield table_row(SHAPE_COLUMNS, point)


SHAPES = table_writer(
    "shapes",
    "mode shapes and their curvature, one row per recording, mode and marker of known position",
    shape_rows,
    SHAPE_COLUMNS,
)
