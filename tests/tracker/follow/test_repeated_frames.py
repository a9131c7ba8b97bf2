"""Repeated frames are found by image and motion together, in any codec; rest and turning points are none."""

import numpy as np
import pytest
from kit import films as media

from tracker import TrackerSettings, flags, track
from tracker.follow import image_change, repeated_frames

N = 600
NOISE_PX = 0.03


def decay(seed, n=N, cycles_per_frame=0.0913):
    """Positions of two markers, in px, with noise, and changes of the images, which scatter by a third."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    motion = 3.0 * np.exp(-t / 800) * np.sin(2 * np.pi * cycles_per_frame * t + rng.uniform(0, 6))
    x = motion[:, None] * [1.0, -0.7] + NOISE_PX * rng.standard_normal((n, 2))
    y = NOISE_PX * rng.standard_normal((n, 2))
    change = rng.lognormal(0.0, 0.3, n) * (0.5 + np.abs(np.gradient(motion)))
    change[0] = np.nan
    return x, y, change


def repeat(x, y, change, frames, seed=0):
    """Repeat the last image before each of the frames; a lossy codec refines it by 0.003 px and a few percent."""
    rng = np.random.default_rng([seed, 3])
    usual = np.nanmedian(change)
    for k in sorted(frames):
        for positions in (x, y):
            positions[k] = positions[k - 1] + 0.003 * rng.standard_normal(positions.shape[1])
        change[k] = usual * rng.uniform(0.0, 0.1)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("length", [1, 2, 3, 5, 12])
def test_runs_of_repeated_frames_are_found_wherever_they_are(seed, length):
    x, y, change = decay(seed)
    rng = np.random.default_rng([seed, length])
    starts = [*rng.integers(20, N - 60, 2), N - length]
    frames = {int(s) + j for s in starts for j in range(length)}
    true = x.copy()
    repeat(x, y, change, frames)
    found = set(np.flatnonzero(repeated_frames(change, x, y)).tolist())
    assert found <= frames
    # What is missed is where it would have been: within 5 sd of a prediction that is at most twice as uncertain as a
    # position, near a turning point of the motion.
    missed = sorted(frames - found)
    assert all(np.max(np.abs(x[k] - true[k])) < 10 * NOISE_PX for k in missed)
    assert len(missed) <= 0.25 * len(frames) or length == 1


@pytest.mark.parametrize("seed", range(12))
def test_nothing_is_found_where_nothing_is_repeated(seed):
    x, y, change = decay(seed)
    assert not repeated_frames(change, x, y).any()


def test_turning_points_without_noise_are_no_repetitions():
    """31 frames a cycle and slower: image and markers hardly change where the motion turns."""
    t = np.arange(400.0)
    for period in (31, 32, 95, 380):
        x = np.sin(2 * np.pi * t / period)[:, None] * [1.0, -0.8]
        change = np.abs(np.diff(x[:, 0], prepend=np.nan))
        assert not repeated_frames(change, x, 0 * x).any()


def test_a_scene_at_rest_is_no_repetition():
    """Before a release from a deflection and after the decay a lossy codec shows hardly any change."""
    x, y, change = decay(1)
    rng = np.random.default_rng(9)
    for rest, value in ((slice(0, 100), 3.0), (slice(500, N), 0.0)):
        count = x[rest].shape[0]
        x[rest] = value + 0.002 * rng.standard_normal((count, 2))
        y[rest] = 0.002 * rng.standard_normal((count, 2))
        change[rest] = 0.02 * rng.lognormal(0.0, 0.2, count)
    change[0] = np.nan
    x[490:500] *= np.linspace(1.0, 0.0, 10)[:, None]
    assert not repeated_frames(change, x, y).any()


def test_the_change_of_an_image_is_its_mean_absolute_difference():
    rng = np.random.default_rng(2)
    for kind, top in ((np.uint8, 256), (np.uint16, 4096)):
        one, other = rng.integers(0, top, (2, 48, 64)).astype(kind)
        expected = np.mean(np.abs(one[::4].astype(float) - other[::4]))
        assert image_change(one, other) == pytest.approx(expected, rel=1e-12)


CODECS = {"ffv1": {}, "libx264": {"crf": "23"}, "mjpeg": {}}
REPEATED = ([50], [50, 51], [40, 90, 91, 92, 93], [114, 115, 116, 117, 118, 119])
# Fast: each codec and each kind of repetition once, and the last frames in the codec that hardly codes them.
FAST = (("ffv1", 1), ("libx264", 0), ("libx264", 3), ("mjpeg", 2))
FILES = [
    pytest.param(codec, inside, marks=() if (codec, k) in FAST else pytest.mark.slow)
    for k, inside in enumerate(REPEATED)
    for codec in CODECS
]


@pytest.mark.parametrize(("codec", "inside"), FILES)
def test_repeated_frames_of_files_are_found_and_reported(codec, inside, tmp_path):
    """Repeated before the film was written: the codec makes of them what it does of a scene at rest."""
    images = media.images(120)
    for k in inside:
        images[k] = images[k - 1]
    suffix = {"ffv1": "mkv", "libx264": "mp4", "mjpeg": "avi"}[codec]
    path = media.write(tmp_path / f"a.{suffix}", images, codec=codec, options=CODECS[codec])
    tracks = track(path, TrackerSettings(kind="blob", fps=1000, exposure_s=1e-5), recording="a")
    found = np.flatnonzero(tracks.flags[:, 0] & flags.DUPLICATE_FRAME.value).tolist()
    assert found == inside
    (note,) = (note for note in tracks.notes if f"{len(inside)} of 120 frames repeat" in note)
    assert ("(user)" in note) == (len(inside) > 3), "many are a reason to doubt the time axis"
