"""Other tools at the stations of a line: displacements along its normals in a film, without standard deviations."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.line_scenes import Array, LineScene
from tracker.video import open_recording

# From a film, its number of frames, points (m, 2) px in the first frame and unit normals (m, 2), both x before y, to
# displacements along the normals (n, m).
Peer = Callable[[Path, int, Array, Array], Array]


def pyidi_directional(
    across_px: int, along_px: int, path: Path, frames: int, points: Array, normals: Array
) -> Array:
    """Directional Lucas-Kanade of pyidi; its windows follow the pixels: `across_px` horizontally.

    The first frame is the reference. Points are rounded to whole pixels, which it requires.
    """
    import numba  # noqa: PLC0415 - with its optional user
    import pyidi  # noqa: PLC0415 - optional dependency

    # CPU time is compared: no threads that wait for each other.
    numba.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        # Its own reader opens the film again for each frame and decodes it from the start.
        images = np.stack(
            [f.image for f in islice(open_recording(path).frames(), frames) if f.image is not None]
        )
        method = pyidi.DirectionalLucasKanade(pyidi.VideoReader(images, root=folder))
        method.set_points(np.rint(points[:, ::-1]).astype(int))
        method.configure(
            roi_size=(along_px, across_px),
            dij=normals[:, ::-1],
            verbose=0,
            show_pbar=False,
        )
        moved: Any = method.get_displacements(autosave=False)
    return np.asarray(np.einsum("mnc,mc->nm", moved, normals[:, ::-1]), dtype=np.float64)


PEERS: dict[str, Peer] = {
    "pyidi directional, 17 x 5 px": partial(pyidi_directional, 17, 5),
    "pyidi directional, 9 x 9 px": partial(pyidi_directional, 9, 9),
}


def peer_errors(peer: Peer, scene: LineScene, path: Path, frames: int, arc_px: Array) -> tuple[float, float]:
    """Rms error of the displacement along the normals of the first frame, px, and share of values."""
    points, normals = scene.points(0.0, arc_px)
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    # The truth is that of the points after rounding.
    s = np.arange(0.0, scene.length_px, 0.05)
    line = scene.points(0.0, s)[0]
    arc = s[[int(np.argmin(np.hypot(*(line - point).T))) for point in np.rint(points)]]
    true = np.stack([np.sum(scene.points(float(k), arc)[0] * normals, axis=1) for k in range(frames)])
    error = peer(path, frames, points, normals) - true
    error = error - np.nanmean(error, axis=0)
    return float(np.sqrt(np.nanmean(error**2))), float(np.mean(np.isfinite(error)))


def not_run(error: Exception) -> str:
    """Reason of a tool that failed, for a cell of a table."""
    return f"not run: {error!r:.80}"
