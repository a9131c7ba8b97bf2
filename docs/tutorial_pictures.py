"""Draw the pictures of docs/index.md and docs/tutorial.md from a sample film: `python docs/tutorial_pictures.py`."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import modalcam as mc
from tracker.video import open_recording

_FILMS = Path(__file__).parents[1] / "sample_videos"
_FILM, _SECOND = _FILMS / "mode1.avi", _FILMS / "mode2.avi"
_POSITIONS_MM = (2.0, 90.0, 190.0, 290.0, 390.0, 490.0)
_INK, _FIT, _GREY = "#1c2126", "#00825f", "#6f7b87"
_WIDTH_IN, _DPI = 7.0, 110


def draw_film(path: Path, tracks: mc.MarkerTracks) -> None:
    """The first frame and one in which the beam is bent most, lying on their sides, with the markers circled."""
    tip = np.abs(tracks.x_px[:, -1] - np.nanmedian(tracks.x_px[:, -1]))
    rows = (0, int(np.nanargmax(tip)))
    with closing(open_recording(_FILM)) as source:
        images = {k: frame.image for k, frame in enumerate(source.frames()) if k in rows}
    figure = Figure(figsize=(_WIDTH_IN, 2.3), dpi=_DPI, layout="constrained")
    for axes, row, title in zip(figure.subplots(2, 1), rows, ("first frame", "largest swing"), strict=True):
        axes.imshow(images[row].T, cmap="gray", vmin=0, vmax=255)
        x, y = tracks.y_px[row], tracks.x_px[row]
        axes.plot(x, y, "o", color="#c05000", markersize=13, markerfacecolor="none")
        for name, *at in zip(tracks.markers, x, y, strict=True):
            axes.annotate(name, at, (9, 6), textcoords="offset points", color=_INK, fontsize=8)
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=9, loc="left")
    _save(figure, path)


def draw_decay(path: Path, found: Any) -> None:
    """Displacement of the last marker: driven, then the decay and its fit; the first cycles of the fit."""
    series, target = found.series, found.target
    channel = int(np.nanargmax(np.abs(target.shape)))
    time_s, values = series.time_s, series.values[:, channel]
    figure = Figure(figsize=(_WIDTH_IN, 2.7), dpi=_DPI, layout="constrained")
    whole, close = figure.subplots(1, 2, width_ratios=(2, 1))
    inside = (time_s >= found.onset.fit_from_s) & (
        time_s < found.onset.fit_from_s + 1.5 / target.frequency_hz
    )
    for axes, rows, style in ((whole, slice(None), "-"), (close, inside, "o")):
        axes.plot(
            time_s[rows], values[rows], style, color=_GREY, linewidth=0.6, markersize=3, label="measured"
        )
        axes.plot(time_s[rows], found.fitted[rows, channel], color=_FIT, linewidth=0.9, label="fitted")
        axes.set(xlabel="time (s)")
    whole.axvline(found.onset.time_s, color=_INK, linestyle=":", linewidth=1.0)
    top = (found.onset.time_s, float(np.nanmax(values)))
    whole.annotate("onset", top, (3, 9), textcoords="offset points", annotation_clip=False)
    whole.set(ylabel=f"displacement ({series.unit})")
    figure.legend(*close.get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=8)
    _save(figure, path)


def draw_overview(path: Path, tracks: mc.MarkerTracks, found: Any) -> None:
    """A frame with its markers, above the decay with its fit and the posterior of the damping ratio."""
    figure = Figure(figsize=(_WIDTH_IN, 3.1), dpi=_DPI, layout="constrained")
    film, below = figure.subfigures(2, 1, height_ratios=(1, 2))
    row = int(np.nanargmax(np.abs(tracks.x_px[:, -1] - np.nanmedian(tracks.x_px[:, -1]))))
    with closing(open_recording(_SECOND)) as source:
        image = next(frame.image for k, frame in enumerate(source.frames()) if k == row)
    axes = film.subplots()
    axes.imshow(image.T, cmap="gray", vmin=0, vmax=255)
    axes.plot(tracks.y_px[row], tracks.x_px[row], "o", color="#c05000", markersize=13, markerfacecolor="none")
    axes.set(xticks=[], yticks=[])
    axes.set_title("A frame of the film, turned by 90°, with the markers found", fontsize=9, loc="left")
    decay, posterior = below.subplots(1, 2, width_ratios=(2, 1))
    series, target = found.series, found.target
    channel = int(np.nanargmax(np.abs(target.shape)))
    decay.plot(series.time_s, series.values[:, channel], color=_GREY, linewidth=0.6, label="measured")
    decay.plot(series.time_s, found.fitted[:, channel], color=_FIT, linewidth=0.9, label="fitted")
    decay.axvline(found.onset.time_s, color=_INK, linestyle=":", linewidth=1.0)
    decay.set(xlabel="time (s)", ylabel=f"displacement ({series.unit})")
    decay.set_title("The free decay is found and fitted", fontsize=9, loc="left")
    decay.set_ylim(top=1.4 * float(np.nanmax(series.values[:, channel])))
    decay.legend(fontsize=8, loc="upper right", ncols=2)
    percent = 100.0 * target.posterior.damping_ratio.ravel()
    posterior.hist(percent, bins=50, color=_FIT, alpha=0.5)
    posterior.axvspan(*np.multiply(100.0, target.damping_interval()), color=_FIT, alpha=0.15)
    posterior.set(xlabel=f"damping ratio at {target.frequency_hz:.4g} Hz (%)", yticks=[])
    posterior.set_title("Posterior and 90 % interval", fontsize=9, loc="left")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    # Without the version of the library the bytes are those of the picture alone.
    figure.savefig(path, metadata={"Software": None}, pil_kwargs={"optimize": True})


def main() -> None:
    """Track and identify the film, and write both pictures."""
    docs = Path(__file__).parent
    tracks = mc.track(_FILM, fps=100.0, mm_per_px=1.0, kind="blob", positions_mm=_POSITIONS_MM)
    draw_film(docs / "tutorial_film.png", tracks)
    found = mc.identify(mc.displacement(tracks), mode=1)
    draw_decay(docs / "tutorial_decay.png", found)
    tracks = mc.track(_SECOND, fps=200.0, mm_per_px=1.0, kind="blob", positions_mm=_POSITIONS_MM)
    draw_overview(docs / "overview.png", tracks, mc.identify(mc.displacement(tracks), frequency_hz=10.0))


if __name__ == "__main__":
    main()
