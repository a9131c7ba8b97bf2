"""`first_frame/<recording>.png`: the first frame of a recording without markers, with axes in pixels."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from modalcam.common import shown
from modalcam.config import ExperimentConfig
from modalcam.pipeline import RunResult, Workspace, replacing
from modalcam.tables.base import Output, Writer
from tracker import FailedTracking

_DPI = 100
# Size of the picture's longer side, without the labels of the axes.
_SIDE_IN = 10.0


def write_first_frame(path: Path, failed: FailedTracking) -> None:
    """Write the frame with a grid and the proposed points, whose coordinates can be read off for `points_px`."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only to draw

    frame = failed.first_frame
    if frame is None:
        msg = "a recording without a frame has no picture"
        raise ValueError(msg)
    height, width = frame.shape
    inch = _SIDE_IN / max(height, width)
    figure = Figure(figsize=(width * inch + 1.0, height * inch + 1.0), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    # Pixel centres are at integers.
    axes.imshow(frame, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.grid(visible=True, linewidth=0.4, color="#56b4e9", alpha=0.6)
    for x, y in () if failed.proposed_px is None else failed.proposed_px:
        axes.plot(x, y, "o", markersize=9, markerfacecolor="none", markeredgecolor="#e69f00")
        axes.annotate(
            f"({x:.0f}, {y:.0f})",
            (x, y),
            (7, 7),
            textcoords="offset points",
            color="#e69f00",
            parse_math=False,
        )
    axes.set_xlabel("x / px")
    axes.set_ylabel("y / px")
    axes.set_title(shown(failed.where), parse_math=False)
    with replacing(path) as temporary:
        # Without the version of the library the bytes are those of the picture alone.
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        failed = recording.tracks
        if isinstance(failed, FailedTracking) and failed.first_frame is not None and failed.first_frame.size:
            path = workspace.first_frame(recording.name)
            yield Output(path, failed, partial(write_first_frame, failed=failed))


FIRST_FRAME = Writer(
    "first_frame",
    "first_frame/<recording>.png",
    "only of a recording without markers: its first frame with axes in px, and points that could be followed",
    _outputs,
)
