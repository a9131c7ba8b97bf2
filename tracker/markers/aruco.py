"""ArUco markers by OpenCV's detector: only to find and name them; positions come from registration."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.base import Detection, FoundMarkers, NothingFound
from tracker.template.parametric import aruco_template
from tracker.video.gray import to_8_bit

# The largest dictionary of each family holds the smaller ones' markers under the same ids.
FAMILIES: tuple[tuple[str, ...], ...] = (
    ("DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000"),
    ("DICT_5X5_50", "DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000"),
    ("DICT_6X6_50", "DICT_6X6_100", "DICT_6X6_250", "DICT_6X6_1000"),
    ("DICT_7X7_50", "DICT_7X7_100", "DICT_7X7_250", "DICT_7X7_1000"),
    ("DICT_ARUCO_ORIGINAL",),
    ("DICT_ARUCO_MIP_36h12",),
    ("DICT_APRILTAG_36h11",),
    ("DICT_APRILTAG_36h10",),
    ("DICT_APRILTAG_25h9",),
    ("DICT_APRILTAG_16h5",),
)
FRAMES_LOOKED_AT = 7
# Where markers come and go between those, all frames are looked at: blur hides a code but near the turning points.
# So many readings without a corrected bit are then asked for, as noise seldom gives even one.
READINGS_WHERE_HIDDEN = 3
MOST_PIXELS = 40_000_000
# A frame must be so much sharper to be taken before an earlier one.
SHARPER = 1.2
# A marker of fewer px is enlarged before detection: the detector needs 4 px a cell.
UPSCALINGS = (1, 2, 3)
FIRST_BLUR_PX = 0.7


@dataclass(frozen=True)
class CodeReading:
    """Corners of one marker, clockwise from its own top left, pixel centres at integers; shape (4, 2)."""

    marker_id: int
    corners_px: FloatArray


def dictionary_names() -> tuple[str, ...]:
    """Names that `TrackerSettings.dictionary` may have."""
    return tuple(name for family in FAMILIES for name in family)


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _detector(name: str, *, strict: bool) -> cv2.aruco.ArucoDetector:
    return detector_of(_dictionary(name), strict=strict)


def detector_of(dictionary: cv2.aruco.Dictionary, *, strict: bool) -> cv2.aruco.ArucoDetector:
    """OpenCV's detector, set for small markers; a strict one takes no code with a wrong bit."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 0.01
    parameters.adaptiveThreshWinSizeMax = 33
    parameters.perspectiveRemovePixelPerCell = 8
    if strict:
        parameters.errorCorrectionRate = 0.0
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def detect(
    image: NDArray[np.uint8], detector: cv2.aruco.ArucoDetector, *, upscaling: int = 1
) -> list[CodeReading]:
    """All markers in a picture; an id seen twice is left out, as nobody can tell which is meant."""
    if upscaling > 1:
        enlarged = cv2.resize(image, None, fx=upscaling, fy=upscaling, interpolation=cv2.INTER_CUBIC)
        image = np.asarray(enlarged, dtype=np.uint8)
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None:
        return []
    seen: dict[int, list[FloatArray]] = defaultdict(list)
    for marker_id, quad in zip(ids.ravel(), corners, strict=True):
        # Resizing keeps areas: pixel p of the small picture is centred at scale * p + (scale - 1) / 2.
        points = (quad.reshape(4, 2).astype(np.float64) - 0.5 * (upscaling - 1)) / upscaling
        seen[int(marker_id)].append(points)
    return [CodeReading(i, quads[0]) for i, quads in sorted(seen.items()) if len(quads) == 1]


def centre_and_warp(corners_px: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Centre, map from the picture to the marker's frame (det of a rotation), and side in px.

    The centre is where the diagonals cross, which perspective leaves alone.
    """
    a, b, c, d = corners_px
    matrix = np.stack([c - a, -(d - b)], axis=1)
    along = np.linalg.solve(matrix, b - a)[0] if abs(np.linalg.det(matrix)) > 1e-9 else 0.5
    centre = np.asarray(a + along * (c - a), dtype=np.float64)
    right = 0.5 * ((b - a) + (c - d))
    down = 0.5 * ((d - a) + (c - b))
    frame = np.stack([right, down], axis=1)
    side = float(np.sqrt(abs(np.linalg.det(frame))))
    return centre, np.asarray(np.linalg.inv(frame / side), dtype=np.float64), side


def _seen_places(seen: dict[int, tuple[int, CodeReading]]) -> FloatArray:
    return np.array([detection.corners_px.mean(axis=0) for _, detection in seen.values()])


def _holds(wanted: str, name: str, largest_id: int) -> bool:
    """Whether the markers that were seen as of one dictionary are of the wanted one as well."""
    if wanted == "auto":
        return False
    family = next(f for f in FAMILIES if name in f)
    return wanted in family and largest_id < _dictionary(wanted).bytesList.shape[0]


def _readings(
    images: dict[int, NDArray[np.uint8]], detector: cv2.aruco.ArucoDetector, upscaling: int
) -> dict[int, list[tuple[int, CodeReading]]]:
    """Frames and places in which each id is read, in order of id."""
    hits: dict[int, list[tuple[int, CodeReading]]] = defaultdict(list)
    for k, image in sorted(images.items()):
        for detection in detect(image, detector, upscaling=upscaling):
            hits[detection.marker_id].append((k, detection))
    return dict(sorted(hits.items()))


def _sharpest(
    images: dict[int, NDArray[np.uint8]], hits: list[tuple[int, CodeReading]]
) -> tuple[int, CodeReading]:
    """The detection with the steepest edges for its contrast; the first where none stands out."""
    best, most = hits[0], 0.0
    for k, detection in hits:
        low = np.maximum(np.floor(detection.corners_px.min(axis=0)).astype(int) - 1, 0)
        high = np.ceil(detection.corners_px.max(axis=0)).astype(int) + 2
        part = images[k][low[1] : high[1], low[0] : high[0]].astype(np.float64)
        steep = np.mean(np.diff(part, axis=0) ** 2) + np.mean(np.diff(part, axis=1) ** 2)
        sharpness = float(steep / max(part.var(), 1.0))
        if sharpness > (SHARPER if most else 0.0) * most:
            best, most = (k, detection), sharpness
    return best


def _square_places(image: NDArray[np.uint8]) -> FloatArray | None:
    """Middles of squares that no code was read in, the largest first; None where there is none."""
    _, _, rejected = _detector("DICT_4X4_50", strict=False).detectMarkers(image)
    quads = [np.asarray(quad, dtype=np.float64).reshape(4, 2) for quad in rejected]
    quads.sort(key=lambda quad: -float(np.ptp(quad, axis=0).prod()))
    return np.array([quad.mean(axis=0) for quad in quads]) if quads else None


class ArucoDetector:
    """Markers of an ArUco dictionary.

    Parameters
    ----------
    dictionary : str
        OpenCV's name, or "auto".
    positions_mm : tuple of float or None
        Distances from the clamp in order of id.
    other_dictionaries : bool
        Whether markers of another dictionary than the named one are taken (with a note), as the kind "auto"
        does; otherwise they are a failure that names them.

    Raises
    ------
    ValueError
        If the dictionary is not one of OpenCV's.
    """

    def __init__(
        self, dictionary: str, positions_mm: tuple[float, ...] | None, *, other_dictionaries: bool = False
    ) -> None:
        names = dictionary_names()
        if dictionary != "auto" and dictionary not in names:
            msg = f"dictionary must be 'auto' or one of {', '.join(names)}; got {dictionary!r}"
            raise ValueError(msg)
        self._wanted = dictionary
        self._positions_mm = positions_mm
        self._other = other_dictionaries or dictionary == "auto"
        self._used = dictionary if dictionary != "auto" else "DICT_4X4_50"
        self._upscaling = 1
        self._hidden = False

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Ids seen in a third of a few frames, or where some come and go, read repeatedly in all; in order of id."""
        picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, FRAMES_LOOKED_AT)})
        images = {k: to_8_bit(frames[k]) for k in picks}
        notes: list[str] = []
        seen: dict[int, tuple[int, CodeReading]] = {}
        if self._wanted != "auto":
            seen = self._look_closely(frames, images, self._wanted)
        if not seen:
            best = self._best_family(images)
            if best is None:
                wanted = "any dictionary" if self._wanted == "auto" else self._wanted
                return NothingFound(
                    f"no ArUco marker of {wanted} was seen in the first {len(frames)} frames",
                    _square_places(images[picks[0]]),
                )
            ids = ", ".join(str(i) for i in best[1])
            if _holds(self._wanted, best[0], max(best[1])):
                return NothingFound(
                    f"ids {ids} of {self._wanted} were read in too few of the first {len(frames)} frames to be "
                    "followed: blurred, small or hidden; record with a shorter exposure or more light",
                    _seen_places(best[1]),
                )
            self._used, seen = best
            if not self._other:
                return NothingFound(
                    f"no marker of {self._wanted} was seen, but ids {ids} of {self._used}: "
                    f"did you mean dictionary = {self._used!r}?",
                    _seen_places(seen),
                )
            seen = self._look_closely(frames, images, self._used) or seen
            ids = ", ".join(str(i) for i in seen)
            notes.append(f"ArUco markers {ids} were recognised as of {self._used}.")
        positions = self._positions(seen)
        if isinstance(positions, NothingFound):
            return positions
        detections = tuple(
            self._detection(frame, detection, position)
            for (frame, detection), position in zip(seen.values(), positions, strict=True)
        )
        return FoundMarkers(detections, tuple(notes))

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        """Detect in one frame; the id names the marker."""
        by_name = {s.name: s for s in sought}
        found = []
        detector = _detector(self._used, strict=False)
        for detection in detect(to_8_bit(image), detector, upscaling=self._upscaling):
            known = by_name.get(f"id{detection.marker_id}")
            if known is None:
                continue
            centre, warp, side = centre_and_warp(detection.corners_px)
            found.append(
                # The warp leads to the frame of the first detection, where its template lives.
                replace(
                    known,
                    x_px=float(centre[0]),
                    y_px=float(centre[1]),
                    warp=warp * (known.size_px / side),
                )
            )
        return found

    def _look(
        self, images: dict[int, NDArray[np.uint8]], name: str, *, strict: bool
    ) -> dict[int, tuple[int, CodeReading]]:
        """Sharpest detection of each id, at the smallest enlargement after which no more are seen."""
        best: dict[int, tuple[int, CodeReading]] = {}
        detector = _detector(name, strict=strict)
        needed = max(1, -(-len(images) // 3))
        for upscaling in UPSCALINGS:
            if upscaling > 1 and max(i.size for i in images.values()) * upscaling**2 > 20_000_000:
                break
            readings = _readings(images, detector, upscaling)
            kept = {i: hits for i, hits in readings.items() if len(hits) >= needed}
            if len(kept) > len(best):
                best = {i: _sharpest(images, hits) for i, hits in kept.items()}
                self._upscaling = upscaling
                self._hidden = any(len(hits) < len(images) for hits in readings.values())
        return best

    def _look_closely(
        self, frames: list[GrayImage], images: dict[int, NDArray[np.uint8]], name: str
    ) -> dict[int, tuple[int, CodeReading]]:
        """As `_look`, and in all frames where codes come and go."""
        self._hidden = True
        seen = self._look(images, name, strict=False)
        if not self._hidden:
            return seen
        step = -(-len(frames) * frames[0].size * self._upscaling**2 // MOST_PIXELS)
        more = {k: to_8_bit(frames[k]) for k in range(0, len(frames), step)} | images
        readings = _readings(more, _detector(name, strict=True), self._upscaling)
        for marker_id, hits in readings.items():
            if marker_id in seen or len(hits) >= READINGS_WHERE_HIDDEN:
                known = [seen[marker_id]] if marker_id in seen else []
                seen[marker_id] = _sharpest(more, [*known, *hits])
        return dict(sorted(seen.items()))

    def _best_family(
        self, images: dict[int, NDArray[np.uint8]]
    ) -> tuple[str, dict[int, tuple[int, CodeReading]]] | None:
        """The smallest dictionary of the family with most markers, read without error correction."""
        best: tuple[str, dict[int, tuple[int, CodeReading]]] | None = None
        few = dict(list(images.items())[:3])
        for family in FAMILIES:
            seen = self._look(few, family[-1], strict=True)
            if seen and (best is None or len(seen) > len(best[1])):
                name = next(n for n in family if _dictionary(n).bytesList.shape[0] > max(seen))
                best = (name, seen)
        if best is None:
            return None
        return best[0], self._look(images, best[0], strict=False) or best[1]

    def _positions(self, seen: dict[int, tuple[int, CodeReading]]) -> list[float] | NothingFound:
        if self._positions_mm is None:
            return [float("nan")] * len(seen)
        if len(self._positions_mm) != len(seen):
            ids = ", ".join(str(i) for i in seen)
            return NothingFound(
                f"positions_mm names {len(self._positions_mm)} markers, but {len(seen)} were seen "
                f"(ids {ids} of {self._used}); give one position for each, in order of id",
                _seen_places(seen),
            )
        return list(self._positions_mm)

    def _detection(self, frame: int, detection: CodeReading, position_mm: float) -> Detection:
        dictionary = _dictionary(self._used)
        cells = dictionary.markerSize + 2
        picture = cv2.aruco.generateImageMarker(dictionary, detection.marker_id, cells)
        bits = (np.asarray(picture) > 127).astype(np.uint8)
        centre, warp, side = centre_and_warp(detection.corners_px)
        return Detection(
            name=f"id{detection.marker_id}",
            kind="aruco",
            frame=frame,
            x_px=float(centre[0]),
            y_px=float(centre[1]),
            warp=warp,
            size_px=side,
            template=aruco_template(bits, side, FIRST_BLUR_PX),
            bits=bits,
            position_mm=position_mm,
        )
