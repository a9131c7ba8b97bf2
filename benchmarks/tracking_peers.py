"""Other tools on the same frames: from frames (n, height, width) and first positions to centres (n, m, 2)."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker import FloatArray

Frames = NDArray[np.uint8]
Peer = Callable[[Frames, FloatArray], FloatArray]
# A detection farther than this from a marker, in px, belongs to a different marker.
NEAR_PX = 20.0


def _square(first_px: FloatArray, side_px: float = 24.0) -> FloatArray:
    """Corners of a marker around each centre, shape (m, 4, 2)."""
    half = 0.5 * side_px
    return first_px[:, None, :] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])[None]


def _aruco(refinement: int) -> Peer:
    def run(frames: Frames, first_px: FloatArray) -> FloatArray:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = refinement
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        out = np.full((len(frames), len(first_px), 2), np.nan)
        for n, frame in enumerate(frames):
            corners, ids, _ = detector.detectMarkers(frame)
            for corner, marker in zip(corners, [] if ids is None else ids.ravel(), strict=True):
                if marker < len(first_px):
                    out[n, marker] = corner.reshape(4, 2).mean(axis=0)
        return out

    return run


def corner_sub_pix(frames: Frames, first_px: FloatArray) -> FloatArray:
    """Refine the four corners, starting from their positions in the previous frame."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
    corners = _square(first_px).reshape(-1, 1, 2).astype(np.float32)
    out = []
    for frame in frames:
        corners = cv2.cornerSubPix(frame, corners, (4, 4), (-1, -1), criteria)
        out.append(corners.reshape(-1, 4, 2).mean(axis=1))
    return np.array(out, dtype=np.float64)


def _pyramid_lk(window: int, *, corners: bool) -> Peer:
    def run(frames: Frames, first_px: FloatArray) -> FloatArray:
        start = (_square(first_px) if corners else first_px[:, None, :]).astype(np.float32)
        each = start.shape[1]
        points, out = start.reshape(-1, 1, 2), []
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
        for frame in frames:
            # Always relative to the first frame, so that errors do not accumulate.
            points, status, _ = cv2.calcOpticalFlowPyrLK(
                frames[0],
                frame,
                start.reshape(-1, 1, 2),
                points.copy(),
                winSize=(window, window),
                maxLevel=2,
                criteria=criteria,
                flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            )
            lost = status.ravel() == 0
            positions = points.reshape(-1, 2).astype(np.float64)
            positions[lost] = np.nan
            out.append(positions.reshape(-1, each, 2).mean(axis=1))
        return np.array(out)

    return run


def _nearest(found_px: FloatArray, around_px: FloatArray) -> FloatArray:
    out = np.full(around_px.shape, np.nan)
    if found_px.size == 0:
        return out
    for k, position in enumerate(around_px):
        gap = np.linalg.norm(found_px - position, axis=1)
        if gap.min() < NEAR_PX:
            out[k] = found_px[int(np.argmin(gap))]
    return out


def simple_blob(frames: Frames, first_px: FloatArray) -> FloatArray:
    """cv2.SimpleBlobDetector on each full frame."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea, parameters.maxArea = 40.0, 400.0
    detector = cv2.SimpleBlobDetector.create(parameters)
    return np.array(
        [
            _nearest(np.array([k.pt for k in detector.detect(f)], dtype=np.float64).reshape(-1, 2), first_px)
            for f in frames
        ]
    )


def trackpy_locate(frames: Frames, first_px: FloatArray) -> FloatArray:
    """trackpy.locate on each full frame, with the diameter chosen for the dots."""
    import trackpy  # noqa: PLC0415 - optional dependency

    trackpy.quiet()
    out = []
    for frame in frames:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # trackpy's warnings about pandas 3
            table = trackpy.locate(255 - frame, 15, minmass=500, engine="numba", characterize=False)
        out.append(_nearest(table[["x", "y"]].to_numpy(), first_px))
    return np.array(out)


def pyidi_lk(window: int) -> Peer:
    """Lucas-Kanade of pyidi on square windows; the first frame is the reference."""

    def run(frames: Frames, first_px: FloatArray) -> FloatArray:
        import pyidi  # noqa: PLC0415 - optional dependency

        with tempfile.TemporaryDirectory() as folder:
            video = pyidi.VideoReader(np.ascontiguousarray(frames), root=folder)
            method = pyidi.LucasKanade(video)
            points = np.rint(first_px[:, ::-1]).astype(int)
            method.set_points(points)
            method.configure(roi_size=(window, window), verbose=0, show_pbar=False, processes=1)
            moved: Any = method.get_displacements(autosave=False)
        # pyidi returns displacements indexed by marker and frame, y before x.
        return np.asarray(points[None] + np.transpose(moved, (1, 0, 2)), dtype=np.float64)[..., ::-1]

    return run


# Name, tool and maximum number of frames, to limit the time of slow tools.
PEERS: dict[str, tuple[tuple[str, Peer, int], ...]] = {
    "aruco": (
        ("cv2.aruco, no refinement", _aruco(cv2.aruco.CORNER_REFINE_NONE), 200),
        ("cv2.aruco SUBPIX", _aruco(cv2.aruco.CORNER_REFINE_SUBPIX), 200),
        ("cv2.aruco CONTOUR", _aruco(cv2.aruco.CORNER_REFINE_CONTOUR), 200),
        ("cv2.aruco APRILTAG", _aruco(cv2.aruco.CORNER_REFINE_APRILTAG), 60),
        ("cornerSubPix in a window", corner_sub_pix, 400),
        ("calcOpticalFlowPyrLK", _pyramid_lk(15, corners=True), 400),
        ("pyidi Lucas-Kanade 31", pyidi_lk(31), 400),
    ),
    "dots": (
        ("cv2.SimpleBlobDetector", simple_blob, 200),
        ("calcOpticalFlowPyrLK", _pyramid_lk(21, corners=False), 400),
        ("trackpy locate", trackpy_locate, 100),
        ("pyidi Lucas-Kanade 21", pyidi_lk(21), 400),
    ),
}
