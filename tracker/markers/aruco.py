"""ArUco markers: detected and identified by OpenCV, located by registration of their printed cells."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.kind import (
    Artwork,
    Detection,
    DetectionSettings,
    FoundMarkers,
    IdealFit,
    MarkerDetector,
    MarkerKind,
    NothingFound,
    fitted,
)
from tracker.template import Template, aruco_template, aruco_values
from tracker.template import template as templates
from tracker.video import to_8_bit


@dataclass(frozen=True)
class Tuning:
    """Reading and fitting of codes."""

    #: [px] per cell at which a reading is compared with its print
    cell_px: int = 8
    #: [frames] in which codes are sought first
    #: convention: limits time
    frames_searched: int = 7
    #: [1] of these frames, in which an id must be read
    read_share: float = 1.0 / 3.0
    #: [frames] in which an id must be read without a corrected bit where codes are readable in some frames only
    #: statistics: noise rarely produces one even once
    readings_where_hidden: int = 3
    #: [pixels] of all frames that are then searched
    #: convention: limits time
    most_pixels: int = 40_000_000
    #: [pixels] of an enlarged frame
    #: convention: chosen for memory
    most_enlarged: int = 20_000_000
    #: [1] factor by which a frame must be sharper to be preferred to an earlier one
    sharper: float = 1.2
    #: [pixels] to which the ideal marker is fitted
    #: convention: limits time
    points_for_shape: int = 1500
    #: [1] correlation with the print that was read, where no dictionary is named
    #: measurement: true codes of 10 px and more have 0.8 and more, shadows and texture with the bits of a code mostly
    #: below 0.75
    least_likeness: float = 0.8
    #: [1] determinant of the map from a detection to the fitted marker, at least
    least_area: float = 0.6
    #: [1] and at most
    most_area: float = 1.6
    #: [1] of the side, of the lens blur of a fitted marker
    largest_blur: float = 0.3


TUNING = Tuning()

# The largest dictionary of each family contains the markers of the smaller ones under the same ids.
FAMILIES: tuple[tuple[str, ...], ...] = (
    *(tuple(f"DICT_{n}X{n}_{count}" for count in (50, 100, 250, 1000)) for n in (4, 5, 6, 7)),
    ("DICT_ARUCO_ORIGINAL",),
    ("DICT_ARUCO_MIP_36h12",),
    ("DICT_APRILTAG_36h11",),
    ("DICT_APRILTAG_36h10",),
    ("DICT_APRILTAG_25h9",),
    ("DICT_APRILTAG_16h5",),
)
# Blurs of a print with which a reading is compared, px of the image.
BLURS_PX = (0.0, 0.7, 1.4)


@dataclass(frozen=True)
class CodeReading:
    """Corners of one marker, clockwise from its own top left, pixel centres at integers; shape (4, 2)."""

    marker_id: int
    corners_px: FloatArray
    frame: int = 0


def dictionary_names() -> tuple[str, ...]:
    """Names that the setting ``dictionary`` accepts besides "auto"."""
    return tuple(name for family in FAMILIES for name in family)


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of this name."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def opencv_detector(dictionary: cv2.aruco.Dictionary, *, strict: bool) -> cv2.aruco.ArucoDetector:
    """OpenCV's detector, configured for small markers; a strict one accepts no code with a wrong bit."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 0.01
    parameters.adaptiveThreshWinSizeMax = 33
    parameters.perspectiveRemovePixelPerCell = 8
    if strict:
        parameters.errorCorrectionRate = 0.0
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def read_codes(
    image: NDArray[np.uint8], detector: cv2.aruco.ArucoDetector, *, upscaling: int = 1
) -> list[CodeReading]:
    """All markers in an image; an id that occurs twice is omitted as ambiguous."""
    if upscaling > 1:
        enlarged = cv2.resize(image, None, fx=upscaling, fy=upscaling, interpolation=cv2.INTER_CUBIC)
        image = np.asarray(enlarged, dtype=np.uint8)
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None:
        return []
    seen: dict[int, list[FloatArray]] = defaultdict(list)
    for marker_id, quad in zip(ids.ravel(), corners, strict=True):
        # Resizing preserves areas: pixel p of the small image is centred at scale * p + (scale - 1) / 2.
        points = (quad.reshape(4, 2).astype(np.float64) - 0.5 * (upscaling - 1)) / upscaling
        seen[int(marker_id)].append(points)
    return [CodeReading(i, quads[0]) for i, quads in sorted(seen.items()) if len(quads) == 1]


def likeness(image: NDArray[np.uint8], reading: CodeReading, dictionary: cv2.aruco.Dictionary) -> float:
    """Correlation of the image with the print of the code, border included, at the best of some blurs.

    A code is read from a bit for each cell; shadows, bricks or texture can have the same bits by chance, but look
    otherwise.
    """
    bits = printed_bits(dictionary, reading.marker_id)
    side = len(bits) * TUNING.cell_px
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], dtype=np.float32) - np.float32(0.5)
    view = cv2.getPerspectiveTransform(reading.corners_px.astype(np.float32), corners)
    seen = cv2.warpPerspective(image, view, (side, side), flags=cv2.INTER_LINEAR).astype(np.float64)
    ideal = np.kron(bits, np.ones((TUNING.cell_px, TUNING.cell_px)))
    if np.ptp(seen) == 0.0:
        return 0.0
    enlarged = side / np.sqrt(max(abs(float(cv2.contourArea(reading.corners_px.astype(np.float32)))), 1.0))
    prints = (ndimage.gaussian_filter(ideal, blur * enlarged, mode="constant", cval=1.0) for blur in BLURS_PX)
    return max(float(np.corrcoef(seen.ravel(), p.ravel())[0, 1]) for p in prints)


def printed_bits(dictionary: cv2.aruco.Dictionary, marker_id: int) -> NDArray[np.uint8]:
    """Cells of a marker, border included, 1 white."""
    drawn = cv2.aruco.generateImageMarker(dictionary, marker_id, dictionary.markerSize + 2)
    return np.asarray(np.asarray(drawn) > 127, dtype=np.uint8)


# Small markers are enlarged before detection: the detector needs 4 px per cell.
UPSCALINGS = (1, 2, 3)

Readings = dict[int, CodeReading]
Images = dict[int, NDArray[np.uint8]]


@dataclass(frozen=True, kw_only=True)
class CodeDetection(Detection):
    """A detected ArUco marker of this number; `bits` are its cells, border included, 1 white."""

    dictionary: str
    marker_id: int
    bits: NDArray[np.uint8]

    @property
    def code(self) -> str:
        """Dictionary and number."""
        return f"{self.dictionary} {self.marker_id}"


def centre_and_warp(corners_px: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Centre, map from the image to the marker's frame (det of a rotation), and side in px.

    The centre is the intersection of the diagonals, which is invariant to perspective.
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


def _centres(seen: Readings) -> FloatArray:
    return np.array([reading.corners_px.mean(axis=0) for reading in seen.values()])


def _at(reading: CodeReading) -> str:
    x, y = reading.corners_px.mean(axis=0)
    return f"x, y = ({x:.0f}, {y:.0f}) px"


def _is_in_dictionary(wanted: str, name: str, largest_id: int) -> bool:
    """Whether markers read with the dictionary `name` belong to the dictionary `wanted` as well."""
    if wanted == "auto":
        return False
    family = next(f for f in FAMILIES if name in f)
    return wanted in family and largest_id < dictionary_of(wanted).bytesList.shape[0]


def _readings(
    images: Images, detector: cv2.aruco.ArucoDetector, upscaling: int
) -> dict[int, list[CodeReading]]:
    """All readings of each id, in order of id."""
    hits: dict[int, list[CodeReading]] = defaultdict(list)
    for k, image in sorted(images.items()):
        for reading in read_codes(image, detector, upscaling=upscaling):
            hits[reading.marker_id].append(replace(reading, frame=k))
    return dict(sorted(hits.items()))


def _sharpest(images: Images, hits: list[CodeReading]) -> CodeReading:
    """The reading with the steepest edges relative to its contrast; the first unless one is clearly better."""
    best, most = hits[0], 0.0
    for reading in hits:
        low = np.maximum(np.floor(reading.corners_px.min(axis=0)).astype(int) - 1, 0)
        high = np.ceil(reading.corners_px.max(axis=0)).astype(int) + 2
        part = images[reading.frame][low[1] : high[1], low[0] : high[0]].astype(np.float64)
        steep = np.mean(np.diff(part, axis=0) ** 2) + np.mean(np.diff(part, axis=1) ** 2)
        sharpness = float(steep / max(part.var(), 1.0))
        if sharpness > (TUNING.sharper if most else 0.0) * most:
            best, most = reading, sharpness
    return best


def _unread_squares(image: NDArray[np.uint8]) -> FloatArray | None:
    """Centres of squares without a readable code, the largest first; None where there is none."""
    _, _, rejected = opencv_detector(dictionary_of("DICT_4X4_50"), strict=False).detectMarkers(image)
    quads = [np.asarray(quad, dtype=np.float64).reshape(4, 2) for quad in rejected]
    quads.sort(key=lambda quad: -float(np.ptp(quad, axis=0).prod()))
    return np.array([quad.mean(axis=0) for quad in quads]) if quads else None


class ArucoDetector:
    """Detects markers of an ArUco dictionary, named as by OpenCV or "auto"; positions are in order of id.

    With `other_dictionaries`, markers of another dictionary than the named one are accepted (with a note), as for the
    kind "auto"; otherwise they are a failure that names them.
    """

    def __init__(
        self,
        dictionary: str,
        positions_mm: tuple[float, ...] | None,
        *,
        other_dictionaries: bool = False,
        kind: MarkerKind | None = None,
    ) -> None:
        self._kind = kind or ARUCO
        self._wanted = dictionary
        self._positions_mm = positions_mm
        self._other = other_dictionaries or dictionary == "auto"
        self._used = dictionary if dictionary != "auto" else "DICT_4X4_50"
        self._upscaling = 1
        self._hidden = False
        self._rejected: list[str] = []

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Ids read in a third of a few frames, or repeatedly in all frames where some are hidden; in order of id."""
        picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, TUNING.frames_searched)})
        images = {k: to_8_bit(frames[k]) for k in picks}
        notes: list[str] = []
        seen: Readings = {}
        if self._wanted != "auto":
            seen = self._read_thoroughly(frames, images, self._wanted)
        if not seen:
            best = self._best_family(images)
            if best is None:
                return self._nothing(len(frames), images[picks[0]])
            ids = ", ".join(str(i) for i in best[1])
            if _is_in_dictionary(self._wanted, best[0], max(best[1])):
                return NothingFound(
                    f"ids {ids} of {self._wanted} were read in too few of the first {len(frames)} frames to be "
                    "tracked: blurred, small or hidden; record with a shorter exposure or more light",
                    seen_px=_centres(best[1]),
                )
            others, self._rejected = self._rejected, []
            self._used, seen = best[0], self._confirmed(frames, images, *best)
            if not seen:
                self._rejected = others + self._rejected
                return self._nothing(len(frames), images[picks[0]])
            ids = ", ".join(str(i) for i in seen)
            if not self._other:
                return NothingFound(
                    f"no marker of {self._wanted} was detected, but ids {ids} of {self._used}: "
                    f"did you mean dictionary = {self._used!r}?",
                    seen_px=_centres(seen),
                )
            notes.append(f"ArUco markers {ids} were recognised as {self._used}.")
        positions = self._positions(seen)
        if isinstance(positions, NothingFound):
            return positions
        detections = tuple(
            self._detection(reading, position)
            for reading, position in zip(seen.values(), positions, strict=True)
        )
        first = {d.name: (d.x_px, d.y_px) for d in self.redetect(frames[0], detections)}
        detections = tuple(replace(d, first_px=first.get(d.name)) for d in detections)
        return FoundMarkers(detections, tuple(notes), tuple(self._rejected))

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        """Detect in one frame; the id identifies the marker."""
        by_id = {s.marker_id: s for s in sought if isinstance(s, CodeDetection)}
        found: list[Detection] = []
        detector = opencv_detector(dictionary_of(self._used), strict=False)
        for reading in read_codes(to_8_bit(image), detector, upscaling=self._upscaling):
            first = by_id.get(reading.marker_id)
            if first is None:
                continue
            centre, warp, side = centre_and_warp(reading.corners_px)
            # The warp leads to the frame of the first detection, in which its template is defined.
            warp = warp * (first.size_px / side)
            found.append(replace(first, x_px=float(centre[0]), y_px=float(centre[1]), warp=warp))
        return found

    def _nothing(self, frames: int, image: NDArray[np.uint8]) -> NothingFound:
        searched = "any dictionary" if self._wanted == "auto" else self._wanted
        reason = f"no ArUco marker of {searched} was detected in the first {frames} frames"
        if self._rejected:
            reason += f" (rejected: {'; '.join(self._rejected)})"
        return NothingFound(reason, seen_px=_unread_squares(image), rejected=tuple(self._rejected))

    def _read(self, images: Images, name: str, *, strict: bool, share: float | None = None) -> Readings:
        """Sharpest reading of each id, at the smallest enlargement beyond which no more ids are read.

        An id counts when it is read in this share of the images, and in two of several unless the share is 0.
        """
        share = TUNING.read_share if share is None else share
        best: Readings = {}
        detector = opencv_detector(dictionary_of(name), strict=strict)
        needed = max(1, min(2, len(images)), int(np.ceil(share * len(images)))) if share else 1
        for upscaling in UPSCALINGS:
            if upscaling > 1 and max(i.size for i in images.values()) * upscaling**2 > TUNING.most_enlarged:
                break
            readings = _readings(images, detector, upscaling)
            kept = {i: hits for i, hits in readings.items() if len(hits) >= needed}
            if len(kept) > len(best):
                best = {i: _sharpest(images, hits) for i, hits in kept.items()}
                self._upscaling = upscaling
                self._hidden = any(len(hits) < len(images) for hits in readings.values())
        return best

    def _read_thoroughly(self, frames: list[GrayImage], images: Images, name: str) -> Readings:
        """As `_read`, and in all frames where codes are hidden in some."""
        self._hidden = True
        seen = self._read(images, name, strict=False)
        if not self._hidden:
            return seen
        step = -(-len(frames) * frames[0].size * self._upscaling**2 // TUNING.most_pixels)
        more = {k: to_8_bit(frames[k]) for k in range(0, len(frames), step)} | images
        readings = _readings(more, opencv_detector(dictionary_of(name), strict=True), self._upscaling)
        for marker_id, hits in readings.items():
            if marker_id in seen or len(hits) >= TUNING.readings_where_hidden:
                earlier = [seen[marker_id]] if marker_id in seen else []
                seen[marker_id] = _sharpest(more, [*earlier, *hits])
        return dict(sorted(seen.items()))

    def _best_family(self, images: Images) -> tuple[str, Readings] | None:
        """The smallest dictionary of the family with most markers that look like their print, perhaps read once."""
        best: tuple[str, Readings] | None = None
        first_images = dict(list(images.items())[:3])
        for family in FAMILIES:
            seen = self._like_their_print(
                first_images, self._read(first_images, family[-1], strict=True, share=0.0), family[-1]
            )
            if seen and (best is None or len(seen) > len(best[1])):
                name = next(n for n in family if dictionary_of(n).bytesList.shape[0] > max(seen))
                best = (name, seen)
        return best

    def _confirmed(self, frames: list[GrayImage], images: Images, name: str, first: Readings) -> Readings:
        """Markers of a dictionary that are read repeatedly and look like their print."""
        read = self._read_thoroughly(frames, images, name)
        for marker_id in sorted(set(first) - set(read)):
            where = _at(first[marker_id])
            self._rejected.append(f"id {marker_id} of {name} at {where} was read in too few frames")
        shown = {reading.frame: to_8_bit(frames[reading.frame]) for reading in read.values()}
        return self._like_their_print(shown, read, name)

    def _like_their_print(self, images: Images, seen: Readings, name: str) -> Readings:
        """The readings whose image resembles the marker that was read; the others are recorded as rejected."""
        kept: Readings = {}
        for marker_id, reading in seen.items():
            found = likeness(images[reading.frame], reading, dictionary_of(name))
            if found >= TUNING.least_likeness:
                kept[marker_id] = reading
            else:
                self._rejected.append(
                    f"id {marker_id} of {name} at {_at(reading)} does not look like its print (correlation {found:.2f})"
                )
        return kept

    def _positions(self, seen: Readings) -> list[float] | NothingFound:
        if self._positions_mm is None:
            return [float("nan")] * len(seen)
        if len(self._positions_mm) != len(seen):
            ids = ", ".join(str(i) for i in seen)
            return NothingFound(
                f"positions_mm names {len(self._positions_mm)} markers, but {len(seen)} were detected "
                f"(ids {ids} of {self._used}); give one position for each, in order of id",
                seen_px=_centres(seen),
            )
        return list(self._positions_mm)

    def _detection(self, reading: CodeReading, position_mm: float) -> CodeDetection:
        dictionary = dictionary_of(self._used)
        bits = printed_bits(dictionary, reading.marker_id)
        centre, warp, side = centre_and_warp(reading.corners_px)
        return CodeDetection(
            name=self._kind.marker_name(reading.marker_id),
            kind=self._kind,
            frame=reading.frame,
            x_px=float(centre[0]),
            y_px=float(centre[1]),
            warp=warp,
            size_px=side,
            template=aruco_template(bits, side, templates.TUNING.first_blur_px),
            dictionary=self._used,
            marker_id=reading.marker_id,
            bits=bits,
            position_mm=position_mm,
        )


class ArucoKind(MarkerKind):
    """Square markers with a code: each is identified in any frame, with its orientation."""

    name = "aruco"
    auto_rank = 0
    angle_while_learning = True
    has_nominal_shape = True
    decodes_shape = True
    # A larger marker has pixels enough in one frame to fit its ideal template directly.
    largest_learned_px = 90.0
    artwork = Artwork("code", gray_percentiles=(5.0, 95.0))

    def detector(self, settings: DetectionSettings, *, auto: bool) -> MarkerDetector | None:
        """Detector of the dictionary in the settings; of any dictionary where `auto`."""
        return ArucoDetector(settings.dictionary, settings.positions_mm, other_dictionaries=auto, kind=self)

    def fit_learned(self, detection: Detection, learned: Template) -> IdealFit | None:
        """The ideal marker fitted to a learned template."""
        inside = learned.support > 0
        points = np.stack([a[inside] for a in np.meshgrid(*learned.axes_px())])
        return self.fit_pixels(detection, points, learned.values()[inside])

    def fit_pixels(self, detection: Detection, points_uv: FloatArray, gray: FloatArray) -> IdealFit | None:
        """Affine map, blur and both gray levels; None when the fit leaves the marker's neighbourhood."""
        assert isinstance(detection, CodeDetection)  # noqa: S101 - made by this kind's detector
        bits, size = detection.bits, detection.size_px
        every = max(1, points_uv.shape[1] // TUNING.points_for_shape)
        points, gray = points_uv[:, ::every], gray[::every]
        low, high = np.percentile(gray, (10, 90))

        def residual(p: FloatArray) -> FloatArray:
            matrix = np.array([[1.0 + p[2], p[3]], [p[4], 1.0 + p[5]]])
            at = matrix @ (points - p[:2, None])
            ideal = aruco_values(at[0], at[1], bits, size, np.exp(p[6]))
            return np.asarray((p[7] + (p[8] - p[7]) * ideal - gray) / max(high - low, 1e-9))

        start = np.array([0, 0, 0, 0, 0, 0, np.log(templates.TUNING.first_blur_px), low, high])
        scales = [1, 1, 0.1, 0.1, 0.1, 0.1, 1, 50, 50]
        found = fitted(residual, start, scales)
        matrix = np.eye(2) + found[2:6].reshape(2, 2)
        blur, dark, light = float(np.exp(found[6])), float(found[7]), float(found[8])
        if (
            not TUNING.least_area < np.linalg.det(matrix) < TUNING.most_area
            or blur > TUNING.largest_blur * size
            or light <= dark
        ):
            return None
        return IdealFit(aruco_template(bits, size, blur), matrix, found[:2], dark, light, size)

    def marker_name(self, rank: int) -> str:
        """Name of the marker with this id."""
        return f"id{rank}"


ARUCO = ArucoKind()
