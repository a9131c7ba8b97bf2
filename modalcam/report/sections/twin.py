"""Measured and simulated frames of the same instants as one looped film: a sheet of frames that style sheets move."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.format import significant
from modalcam.video.results import KeptFrames, SimulatedFootage

_SHOWN_PER_S = 12.0
_GAP_PX = 6
_WEBP_QUALITY = 60
# The close-up: what the eye needs to see tenths of a pixel.
_CLOSE_UP_PX = 32
_CLOSE_UP_SHOWN_PX = 176
# A sheet is a row of frames, and no WebP is wider than 16383 px.
_LARGEST_SIDE_PX = 16_000


@dataclass(frozen=True)
class FilmView:
    """One sheet as a data URI, and the size in which one of its frames is shown."""

    data_uri: str
    width: int
    height: int
    alt: str
    label: str


@dataclass(frozen=True)
class TwinView:
    """The films of a recording, all in step.

    Attributes
    ----------
    whole : FilmView
        Measured beside (or above) simulated.
    close_ups : tuple of FilmView
        The marker that moves most: measured, simulated.
    frames : int
    duration_s : float
        Of one loop.
    caption : str
    """

    whole: FilmView
    close_ups: tuple[FilmView, ...]
    frames: int
    duration_s: float
    caption: str


def twin_view(footage: KeptFrames, twin: SimulatedFootage) -> TwinView:
    """Film of a recording beside its simulation."""
    n, height, width = twin.images.shape
    beside = height >= width
    gap = np.full((n, height, _GAP_PX) if beside else (n, _GAP_PX, width), 128, np.uint8)
    frames = np.concatenate([footage.images, gap, twin.images], axis=2 if beside else 1)
    frames = frames[: max(1, _LARGEST_SIDE_PX // frames.shape[2])]
    n = frames.shape[0]
    order = "left measured, right simulated" if beside else "above measured, below simulated"
    whole = FilmView(
        data_uri=_sheet(frames),
        width=frames.shape[2],
        height=frames.shape[1],
        alt=f"Looped film of {n} frames of the vibrating beam: {order}.",
        label=order[0].upper() + order[1:],
    )
    return TwinView(
        whole=whole,
        close_ups=_close_ups(footage, twin, n),
        frames=n,
        duration_s=round(n / _SHOWN_PER_S, 3),
        caption=_caption(twin, n),
    )


def _close_ups(footage: KeptFrames, twin: SimulatedFootage, frames: int) -> tuple[FilmView, ...]:
    height, width = twin.images.shape[1:]
    side = min(_CLOSE_UP_PX, height, width)
    left = int(np.clip(round(twin.most_moving_px[0]) - side // 2, 0, width - side))
    top = int(np.clip(round(twin.most_moving_px[1]) - side // 2, 0, height - side))
    return tuple(
        FilmView(
            data_uri=_sheet(film[:frames, top : top + side, left : left + side]),
            width=_CLOSE_UP_SHOWN_PX,
            height=_CLOSE_UP_SHOWN_PX,
            alt=f"The marker that moves most, {what} and enlarged.",
            label=what[0].upper() + what[1:],
        )
        for film, what in ((footage.images, "measured"), (twin.images, "simulated"))
    )


def _sheet(frames: NDArray[np.uint8]) -> str:
    """Frames side by side as a data URI."""
    done, coded = cv2.imencode(
        ".webp", np.concatenate(list(frames), axis=1), [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY]
    )
    if not done:
        msg = f"{frames.shape[0]} frames of {frames.shape[1:]} could not be coded as WebP"
        raise ValueError(msg)
    return "data:image/webp;base64," + base64.b64encode(coded.tobytes()).decode("ascii")


def _caption(twin: SimulatedFootage, frames: int) -> str:
    time_s = twin.time_s[:frames]
    step_s = float(np.median(np.diff(time_s)))
    slower = 1.0 / (_SHOWN_PER_S * step_s)
    speed = "times slower" if slower >= 1.0 else "times faster"
    factor = significant(max(slower, 1.0 / slower), 2)
    periods = significant((float(time_s[-1] - time_s[0]) + step_s) / twin.period_s, 2)
    largest = (
        f"{significant(twin.largest_mm, 2)} mm or {significant(twin.largest_mm / twin.mm_per_px, 2)} pixels"
    )
    sentences = [
        (
            f"{frames} frames of the recording from {significant(float(time_s[0]), 5)} s on, {periods} periods, and "
            "the same instants of the updated beam under the generic damping, simulated from the beginning of the fit "
            "on and filmed with the recording’s scale, exposure, gray levels and noise."
        ),
        "The simulation’s markers rest where the recording’s do; how they move is simulated.",
        f"Shown {factor} {speed} than recorded. Amplitudes are true to scale; the largest is {largest} here.",
    ]
    if np.isfinite(twin.difference_mm):
        apart = significant(twin.difference_mm, 2)
        sentences.append(f"Measured and simulated centres are {apart} mm apart (rms) in these frames.")
    return " ".join(sentences)
