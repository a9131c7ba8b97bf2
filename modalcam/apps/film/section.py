"""The films in the report: the recording beside the simulated beam, and the line of a bare beam, exaggerated."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.apps.film.exaggerated import ExaggeratedFilm, exaggerated_film
from modalcam.apps.film.footage import KeptFrames, SimulatedFootage
from modalcam.pipeline import Cache, RecordingResult, code_sha256, digest
from modalcam.report import shown_mode
from modalcam.report.sections import data_uri
from tracker import MarkerTracks
from tracker.markers import kind_of

_LONGEST_SIDE_PX = 420
# Frames of a film that are shown in a second.
SHOWN_PER_S = 12.0
_FILM_GAP_PX = 6
_CLOSE_UP_PX = 32
CLOSE_UP_SHOWN_PX = 176
# A sheet is a row of frames, and WebP is limited to 16383 px.
_LARGEST_SIDE_PX = 16_000


def film_view(recording: RecordingResult, cache: Cache | None) -> dict[str, Any] | None:
    """Variables of ``footage.html.j2``; None without a film of the simulated beam."""
    kept, simulated = recording.added.get("frames"), recording.added.get("simulated")
    if not isinstance(kept, KeptFrames) or not isinstance(simulated, SimulatedFootage):
        return None
    key = ("film", code_sha256(__name__), kept, simulated)
    made = (
        film(kept, simulated) if cache is None else cache.cached(digest(key), lambda: film(kept, simulated))
    )
    return made | {"footage": simulated, "shown_per_s": SHOWN_PER_S, "close_up_px": CLOSE_UP_SHOWN_PX}


def exaggerated_view(recording: RecordingResult, cache: Cache | None) -> dict[str, Any] | None:
    """Variables of ``exaggerated.html.j2``; None where the recording is not one of a line with a mode."""
    tracks, found = recording.tracks, recording.identified
    mode = None if found is None else shown_mode(found)
    if not isinstance(tracks, MarkerTracks) or found is None or mode is None:
        return None
    if not kind_of(tracks.kind).follows_line:
        return None

    def make() -> dict[str, Any]:
        made = exaggerated_film(tracks, found, mode)
        return exaggerated(made) if isinstance(made, ExaggeratedFilm) else {}

    key = ("exaggerated", code_sha256(exaggerated_film.__module__, __name__), tracks, mode)
    made = make() if cache is None else cache.cached(digest(key), make)
    return made | {"mode": mode, "shown_per_s": SHOWN_PER_S} if made else None


def film(kept: KeptFrames, simulated: SimulatedFootage) -> dict[str, Any]:
    """Sheets of images side by side: measured and simulated together, and close-ups of the marker that moves most."""
    n, height, width = simulated.images.shape
    is_side_by_side = height >= width
    gap = np.full((n, height, _FILM_GAP_PX) if is_side_by_side else (n, _FILM_GAP_PX, width), 128, np.uint8)
    frames = np.concatenate([kept.images, gap, simulated.images], axis=2 if is_side_by_side else 1)
    frames = frames[: max(1, _LARGEST_SIDE_PX // frames.shape[2])]
    n = frames.shape[0]
    side = min(_CLOSE_UP_PX, height, width)
    x, y = simulated.most_moving_px
    left = int(np.clip(round(x) - side // 2, 0, width - side))
    top = int(np.clip(round(y) - side // 2, 0, height - side))
    close_up = np.s_[:n, top : top + side, left : left + side]
    return {
        "frames": n,
        "beside": is_side_by_side,
        "width": frames.shape[2],
        "height": frames.shape[1],
        "sheet": _sheet(frames),
        "close_ups": (_sheet(kept.images[close_up]), _sheet(simulated.images[close_up])),
        "step_s": float(np.median(np.diff(simulated.time_s[:n]))),
    }


def exaggerated(made: ExaggeratedFilm) -> dict[str, Any]:
    """Sheet of the frames of a film, and both turning points for print."""
    n, height, width = made.images.shape
    shrink = min(1.0, _LONGEST_SIDE_PX / max(height, width), _LARGEST_SIDE_PX / (n * width))
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    frames = np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in made.images])
    return {
        "frames": n,
        "width": size[0],
        "height": size[1],
        "sheet": _sheet(frames),
        "stills": (_sheet(frames[:1]), _sheet(frames[n // 2 : n // 2 + 1])),
        "factor": made.factor,
        "largest_px": made.largest_px,
    }


def _sheet(frames: NDArray[np.uint8]) -> str:
    """Frames side by side as a data URI."""
    return data_uri("webp", np.concatenate(list(frames), axis=1), [cv2.IMWRITE_WEBP_QUALITY, 60])
