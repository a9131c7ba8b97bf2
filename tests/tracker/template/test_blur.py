"""Motion blur of 10 px along curved paths: positions against the bound, with known and unknown exposure."""

import re

import numpy as np
import pytest
from kit.scenes import FPS, Recording, cramer_rao_px, errors_px

from tracker import TrackerSettings, flags, track
from tracker.markers import ArucoDetector, NothingFound
from tracker.template import Blurrer, disc_template, disc_values, exposed_path_px, unblurred


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def blurred_scene(request, tmp_path_factory):
    """Two markers that move 10 px in an exposure of 0.9 of the time between frames, with 23 frames per period."""
    recording = Recording(
        request.param,
        frames=72,
        markers=2,
        width_px=320,
        height_px=160,
        amplitude_px=40.0,
        frequency_hz=44.2,
        exposure_s=0.0009,
    )
    path = recording.write(tmp_path_factory.mktemp("blur") / "scene.mkv")
    # The bound has twice and four times the frequency of the motion: three phases give its mean.
    times = np.linspace(0.0, 1.0 / recording.frequency_hz, 4)[:-1]
    bound = rms([cramer_rao_px(recording, 1, with_angle=request.param == "aruco", time_s=t) for t in times])
    return recording, path, bound


@pytest.mark.parametrize(
    ("blurred_scene", "exposure_s"),
    [
        # fast: under blur with a given exposure, a dot in test_accuracy.py and a code in test_real_footage.py
        pytest.param("blob", 0.0009, marks=pytest.mark.slow),
        ("blob", None),
        pytest.param("aruco", 0.0009, marks=pytest.mark.slow),
        pytest.param("aruco", None, marks=pytest.mark.slow),
    ],
    indirect=["blurred_scene"],
)
def test_errors_under_10_px_of_blur_are_near_the_bound(blurred_scene, exposure_s):
    recording, path, bound = blurred_scene
    assert 9.5 < recording.blur_px() < 10.5
    settings = TrackerSettings(fps=FPS, kind=recording.kind, dictionary="DICT_4X4_50", exposure_s=exposure_s)
    tracks = track(path, settings, recording="scene")
    assert tracks, tracks.reason
    assert len(tracks.markers) == 2
    errors = np.stack(errors_px(tracks, recording.truth_px()))
    assert np.all(np.isfinite(errors)), f"{np.count_nonzero(np.isnan(errors))} coordinates are lost"
    # 288 errors: the ratio of a perfect estimator scatters by 1 / sqrt(576) = 4.2 %; four of these, and 5 % for
    # a template from a dozen sharp frames.
    ratio = rms(errors) / bound
    assert ratio < 1.22, (
        f"rms {rms(errors):.4f} px is {ratio:.3f} of the bound of {bound:.4f} px with this blur"
    )
    stated = rms(errors / np.stack([tracks.sd_x_px, tracks.sd_y_px]))
    assert 0.83 < stated < 1.17, f"error over stated sd is {stated:.3f}"
    fast = np.abs(np.gradient(recording.truth_px()[:, :, 0], axis=0)) > 3.0
    assert np.all((tracks.flags & flags.BLURRED.value > 0) | ~fast)
    matches = [re.search(r"gives ([\d.]+) \+- ([\d.]+) of the time between", note) for note in tracks.notes]
    estimates = [match for match in matches if match]
    if exposure_s is not None:
        assert not estimates, "a given exposure is not estimated"
        return
    share, sd = (float(estimates[0].group(k)) for k in (1, 2))
    # The motion is estimated from mean positions during the exposures: smaller by (pi f T)^2 / 6 = 0.26 %, and by
    # 0.2 % for a cubic through four positions; the numbers in the note are rounded to 0.0005.
    assert abs(share - 0.9) < 4.0 * sd + 0.006, (
        f"exposure {share} +- {sd} of the time between frames, the true value is 0.9"
    )


def test_a_blurred_template_is_the_mean_along_the_path():
    path = exposed_path_px(np.array([8.0, 3.0]), np.array([2.0, -3.0]), 0.9)
    got = Blurrer(disc_template(6.0, 0.7)).get(path)
    rows, cols = got.coefs.shape
    u, v = ((np.arange(n) - 0.5 * (n - 1)) / got.oversampling for n in (cols, rows))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    mean = np.zeros((rows, cols))
    for s, weight in zip(0.5 * nodes, 0.5 * weights, strict=True):
        du, dv = path[0] * s + 0.5 * path[1] * (s * s - 1.0 / 12.0)
        mean += weight * disc_values(u - du, v - dv, 6.0, 0.7)
    inside = got.support > 0
    # A grid of 4 points per px aliases exp(-2 pi^2 0.7^2 2^2) of the finest detail: negligible against float32.
    assert np.abs(got.values() - mean)[inside].max() < 1e-4
    assert np.all(mean[~inside] < 1e-3), "the support covers the whole disc"


def test_a_blurred_template_uses_only_its_support():
    template = disc_template(6.0, 0.7)
    path = exposed_path_px(np.array([8.0, 0.0]), np.zeros(2), 1.0)
    unlimited, limited = Blurrer(template).get(path), Blurrer(template, template.support).get(path)
    assert limited.area_px < template.area_px < unlimited.area_px
    # Along a path of 8 px, a disc of radius r is fully supported where two discs 8 px apart overlap.
    r = template.reach_px
    lens = 2.0 * r**2 * np.arccos(4.0 / r) - 8.0 * np.sqrt(r**2 - 16.0)
    assert limited.area_px == pytest.approx(lens, rel=0.08), "within half a grid point along the rim"


def test_slight_blur_is_removed():
    still = disc_template(6.0, 0.7)
    paths = [exposed_path_px(np.array([x, y]), np.zeros(2), 1.0) for x, y in ((0.4, 0), (2, 1), (1.5, -2))]
    blurred_templates = [Blurrer(still).get(p) for p in paths]
    size = np.array([t.coefs.shape for t in blurred_templates]).max(axis=0)
    mean = np.zeros(tuple(size))
    for t in blurred_templates:
        rows, cols = ((size - t.coefs.shape) // 2).tolist()
        mean += np.pad(t.coefs, ((rows, rows), (cols, cols)), mode="edge") / 3.0
    blurred = type(still)(mean, np.ones(mean.shape, dtype=np.uint8), still.oversampling)
    back = unblurred(blurred, paths)
    cut = [(n - m) // 2 for n, m in zip(mean.shape, still.coefs.shape, strict=True)]

    def error(template):
        rows, cols = still.coefs.shape
        big = template.values()
        part = big[max(cut[0], 0) :, max(cut[1], 0) :][:rows, :cols]
        at = [max(-c, 0) for c in cut]
        sharp = still.values()[at[0] :, at[1] :][: part.shape[0], : part.shape[1]]
        return rms(part[: sharp.shape[0], : sharp.shape[1]] - sharp)

    assert error(back) < 0.1 * error(blurred)


def test_a_code_read_in_too_few_frames_is_the_stated_reason():
    recording = Recording("aruco", frames=1, markers=3, width_px=480, height_px=160)
    shown = recording.images()[0]
    empty = np.full_like(shown, 200)
    found = ArucoDetector("DICT_4X4_50", None).detect([shown, *[empty] * 20])
    assert isinstance(found, NothingFound)
    assert "too few of the first 21 frames" in found.reason
    assert "but ids" not in found.reason


def test_codes_unreadable_in_most_frames_are_found():
    recording = Recording("aruco", frames=1, markers=3, width_px=480, height_px=160)
    shown = recording.images()[0]
    frames = [shown if k % 16 == 5 else np.full_like(shown, 200) for k in range(64)]
    found = ArucoDetector("DICT_4X4_50", None).detect(frames)
    assert [s.name for s in found.detections] == ["id0", "id1", "id2"]
    assert all(s.frame % 16 == 5 for s in found.detections)
