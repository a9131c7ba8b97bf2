"""Figures as files for papers and slides: SVG, PDF, the data that each shows, and their captions."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from modalcam.pipeline import RunResult, replacing, write_text
from modalcam.report.figures import RECORDING_PLACES, RUN_PLACES, FigureKind, RecordingSubject, shown_in
from modalcam.report.style import figure_style, new_figure

# Widths of one and of two columns of a journal in inches (89 and 183 mm), and sizes of letters in points.
COLUMNS = {1: (3.5, 7.0), 2: (7.2, 8.0)}
# No dates: the same results give the same bytes.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


class _Job(NamedTuple):
    name: str
    source: str
    kind: FigureKind[Any]
    shown: Any


def write_figures(result: RunResult, folder: Path, *, columns: int = 2) -> list[Path]:
    """Write every figure of the report, numbered, into `folder`; those of the whole run first.

    Parameters
    ----------
    columns : {1, 2}
        Columns of a journal that a figure spans.

    Returns
    -------
    list of Path
        ``NN_NAME.svg``, ``.pdf`` and ``.csv`` of each figure, and ``captions.txt``. A row of a CSV file is one point:
        panel, counted from 1; line within it; label of the line; x and y as drawn, NaN where the line is broken.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    captions: list[str] = []
    for job in _jobs(result):
        drawn = _drawn(job, columns)
        if drawn is None:
            continue
        number = len(captions) + 1
        stem = f"{number:02d}_{job.name}"
        files, table = drawn
        for ending, data in files.items():
            written.append(folder / f"{stem}.{ending}")
            with replacing(written[-1]) as temporary:
                temporary.write_bytes(data)
        written.append(folder / f"{stem}.csv")
        write_text(written[-1], table.to_csv(index=False, lineterminator="\n", na_rep="NaN"))
        title, caption = job.kind.caption(job.shown)
        captions.append(f"Figure {number} ({stem}): {title}{job.source}. {caption}".strip())
    written.append(folder / "captions.txt")
    write_text(written[-1], "\n\n".join(captions) + "\n")
    return written


def _jobs(result: RunResult) -> Iterator[_Job]:
    beam = result.beam
    theory = None if beam is None else beam.updated_modes or beam.standard_modes
    for kind, shown in shown_in(RUN_PLACES, result):
        yield _Job(f"run_{kind.key}", "", kind, shown)
    for recording in result.recordings:
        for kind, shown in shown_in(RECORDING_PLACES, RecordingSubject(recording, theory)):
            yield _Job(f"{recording.name}_{kind.key}", f", {recording.file}", kind, shown)


def _drawn(job: _Job, columns: int) -> tuple[dict[str, bytes], pd.DataFrame] | None:
    """The figure in each format and its data; None where there is nothing to draw."""
    width, letters = COLUMNS[columns]
    names = (
        "font.size",
        "axes.labelsize",
        "axes.titlesize",
        "xtick.labelsize",
        "ytick.labelsize",
        "legend.fontsize",
    )
    settings: dict[Any, Any] = dict.fromkeys(names, letters) | {"pdf.fonttype": 42}
    with figure_style(), mpl.rc_context(settings):
        figure = new_figure(job.kind.height_in, width)
        if job.kind.draw(figure, job.shown) is False:
            return None
        files = {}
        for ending, metadata in _METADATA.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=ending, metadata=metadata)
            files[ending] = buffer.getvalue()
        return files, plotted(figure)


def plotted(figure: Figure) -> pd.DataFrame:
    """Points of all lines, bands and dots of a figure in the units of its axes."""
    rows: list[pd.DataFrame] = []
    for panel, axes in enumerate(figure.axes, 1):
        for line, (label, points) in enumerate(_lines(axes), 1):
            named = {"panel": panel, "line": line, "label": label}
            rows.append(pd.DataFrame(points, columns=["x", "y"]).assign(**named))
    columns = ["panel", "line", "label", "x", "y"]
    return pd.concat(rows)[columns] if rows else pd.DataFrame(columns=columns)


def _lines(axes: Axes) -> Iterator[tuple[str, np.ndarray]]:
    """Label and points of what is drawn in data units; guides across a whole panel are not."""
    in_data = [artist for artist in axes.get_children() if artist.get_transform() == axes.transData]
    for line in axes.lines:
        points = np.asarray(line.get_xydata(), dtype=float)
        if line in in_data and points.size:
            yield _label(line), points
    for collection in axes.collections:
        if isinstance(collection, LineCollection | PolyCollection):
            broken = [np.vstack([path.vertices, [[np.nan, np.nan]]]) for path in collection.get_paths()]
            if broken:
                yield _label(collection), np.concatenate(broken)
    for patch in axes.patches:
        if isinstance(patch, Patch) and patch.get_data_transform() == axes.transData:
            yield _label(patch), np.asarray(patch.get_path().vertices, dtype=float)


def _label(artist: Any) -> str:
    text = str(artist.get_label())
    return "" if text.startswith("_") else text
