"""A marker kind registered by a plugin: bright rings, detected, calibrated and tracked."""

from fractions import Fraction

import numpy as np
import pytest
from kit import films as media
from scipy import ndimage

from tracker import TrackerSettings, track
from tracker.markers import (
    Detection,
    DotKind,
    FoundMarkers,
    MarkerKind,
    NothingFound,
    marker_kind,
    register_marker_kind,
    registry,
)
from tracker.template import from_values, grid_px

# Outer and inner radius of a ring, and the sd of the camera noise.
OUTER_PX, INNER_PX, NOISE = 9.0, 5.0, 1.5


def ring(distance_px):
    """Fraction of a pixel covered by a ring, with edges one pixel wide."""
    return np.clip(OUTER_PX - distance_px + 0.5, 0, 1) - np.clip(INNER_PX - distance_px + 0.5, 0, 1)


class RingDetector:
    """Detects bright rings by a threshold, from left to right."""

    def detect(self, frames):
        centres = self._centres(frames[0])
        if not centres:
            return NothingFound("no ring was detected in the first frame")
        return FoundMarkers(tuple(self._detection(k, x, y) for k, (x, y) in enumerate(centres)))

    def redetect(self, image, sought):
        found = []
        for last in sought:
            near = [c for c in self._centres(image) if np.hypot(c[0] - last.x_px, c[1] - last.y_px) < 40]
            found += [last.at(np.array(near[0]))] if len(near) == 1 else []
        return found

    def _centres(self, image):
        labels, count = ndimage.label(image > 120)
        centres = ndimage.center_of_mass(labels > 0, labels, range(1, count + 1))
        return sorted((x, y) for y, x in centres)

    def _detection(self, k, x, y):
        u, v = grid_px(OUTER_PX + 2.5, OUTER_PX + 2.5, 4.0)
        distance = np.hypot(v[:, None], u[None, :])
        template = from_values(ring(distance), (distance <= OUTER_PX + 2.5).astype(np.uint8), 4.0)
        return Detection(f"ring{k + 1}", RING, 0, x, y, np.eye(2), 2 * OUTER_PX, template)


class RingKind(MarkerKind):
    name = "ring"
    auto_rank = -1
    can_have_angle = False

    def detector(self, settings, *, auto):
        return RingDetector()

    def covers(self, u, v, half_u, half_v):
        return np.hypot(u, v) <= half_u


RING = RingKind()


@pytest.fixture
def rings(monkeypatch):
    monkeypatch.setattr(registry, "MARKER_KINDS", dict(registry.MARKER_KINDS))
    register_marker_kind(RING)


def clip(path, n=60):
    """Two rings that vibrate; their centres, shape (n, 2)."""
    t = np.arange(n) / 1000.0
    x = np.stack([40.3 + 2.5 * np.sin(2 * np.pi * 31 * t), 110.7 + 4.0 * np.sin(2 * np.pi * 31 * t + 0.4)], 1)
    v, u = np.indices((60, 160))
    rng = np.random.default_rng(2)
    images = []
    for centres in x:
        light = 60 + 150 * sum(ring(np.hypot(u - c, v - 30.2)) for c in centres)
        images.append(np.clip(np.rint(light + rng.normal(0, NOISE, light.shape)), 0, 255).astype(np.uint8))
    media.write(path, images, codec="ffv1")
    return x


@pytest.mark.parametrize("kind", ["ring", "auto"])
def test_a_registered_kind_is_tracked(kind, rings, tmp_path):
    truth = clip(tmp_path / "a.mkv")
    tracks = track(tmp_path / "a.mkv", TrackerSettings(fps=Fraction(1000), kind=kind, size_mm=9.0))
    assert (tracks.markers, tracks.kind) == (("ring1", "ring2"), "ring")
    assert tracks.scale.mm_per_px == pytest.approx(0.5, rel=0.05), "18 px are 9 mm"
    error = tracks.x_px - truth - np.mean(tracks.x_px - truth, axis=0)
    assert np.all(np.isfinite(error))
    # Fisher information of the edges along x: two circles with a slope of 150 per px, half of it along x.
    bound = NOISE / np.sqrt(np.pi * (OUTER_PX + INNER_PX) * 150.0**2)
    assert np.sqrt(np.mean(error**2)) < 3.0 * bound
    assert 0.7 < np.sqrt(np.mean((error / tracks.sd_x_px) ** 2)) < 1.4


def test_names_are_unique_and_unknown_ones_are_listed(rings):
    with pytest.raises(ValueError, match="'ring' is already registered"):
        register_marker_kind(RingKind())
    with pytest.raises(ValueError, match="one of aruco, blob, patch, line, ring, auto; found 'square'"):
        marker_kind("square")
    with pytest.raises(ValueError, match="found 'square'"):
        TrackerSettings(kind="square")


def test_what_a_kind_of_dots_detects_is_of_its_kind():
    class Leds(DotKind):
        name = "led"

    kind, settings = Leds(), TrackerSettings(fps=100.0)
    found = kind.detector(settings, auto=False).detect(media.images(n=8))
    assert [one.kind for one in found.detections] == [kind]
