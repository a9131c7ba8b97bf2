"""The renderer's quadrature, interpolated motion and video files."""

from fractions import Fraction

import av
import numpy as np
import pytest
from scipy.special import erf
from scipy.stats import norm

from sim.render import SampledMotion, fast_erf, order_for, unit_rule, write_video


@pytest.mark.parametrize("span", [0.1, 0.8, 1.7, 3.3, 8.0])
def test_quadrature_of_a_blurred_edge_is_within_tolerance(span):
    nodes, weights = unit_rule(order_for(span))

    def integral(z):
        return z * norm.cdf(z) + norm.pdf(z)

    centres = np.linspace(-6.0, 6.0, 400)
    exact = (integral(centres + span / 2) - integral(centres - span / 2)) / span
    found = norm.cdf(centres[:, None] + span * nodes) @ weights
    worst = np.max(np.abs(found - exact))
    assert worst < 4.0e-6
    assert order_for(0.0) == 1


def test_error_function_of_the_kernels_is_accurate_to_the_last_bits():
    z = np.concatenate([np.random.default_rng(13).uniform(-7, 7, 20000), np.arange(-384, 385) / 64, [np.inf]])
    found = np.array([fast_erf(value) for value in z])
    # Truncation error of the series: 3e-16; rounding of seven sums below 1: at most 2e-16 each.
    assert np.max(np.abs(found - erf(z))) < 1.0e-15
    assert fast_erf(-np.inf) == -1.0


def test_samples_are_interpolated_with_fourth_order():
    omega = 2 * np.pi * 94.0

    def error(per_cycle):
        t = np.arange(0.0, 0.2, 1.0 / (94.0 * per_cycle))
        x = np.sin(omega * t)[:, None]
        motion = SampledMotion(t, x, 2 * x, 3 * x)
        at = np.linspace(0.02, 0.15, 5000)
        poses = motion(at)
        assert np.allclose(poses.angle_rad, 3 * poses.x_mm)
        return np.max(np.abs(poses.x_mm[:, 0] - np.sin(omega * at)))

    # Error of a cubic spline on a sine: (omega h)^4 / 384 of the amplitude.
    assert error(20) < 1.1 * (2 * np.pi / 20) ** 4 / 384
    assert 14.0 < error(20) / error(40) < 18.0


def test_sampled_motion_is_not_extrapolated_and_must_be_finite():
    t = np.linspace(0.0, 1.0, 11)
    x = np.zeros((11, 2))
    with pytest.raises(ValueError, match=r"sampled from 0 to 1 s, but is needed at 1\.001 s"):
        SampledMotion(t, x, x, x)(np.array([0.5, 1.001]))
    with pytest.raises(ValueError, match="finite"):
        SampledMotion(t, x, np.where(np.arange(22).reshape(11, 2) == 7, np.nan, 0.0), x)
    with pytest.raises(ValueError, match="samples need shape"):
        SampledMotion(t[:-1], x, x, x)


def noisy_frames(dtype, top, n=7, shape=(48, 64)):
    rng = np.random.default_rng(11)
    return [rng.integers(0, top, shape, endpoint=True).astype(dtype) for _ in range(n)]


def smooth_frames(n=7):
    rows, columns = np.indices((48, 64))
    return [
        np.rint(128 + 60 * np.sin(columns / 9 + k / 3) * np.cos(rows / 11)).astype(np.uint8) for k in range(n)
    ]


def decoded(path):
    with av.open(str(path)) as container:
        rate = container.streams.video[0].average_rate
        frames = []
        for frame in container.decode(video=0):
            plane = frame.planes[0]
            dtype = np.uint16 if frame.format.name.endswith("16le") else np.uint8
            line = plane.line_size // np.dtype(dtype).itemsize
            rows = np.frombuffer(plane, dtype=dtype).reshape(-1, line)
            frames.append(rows[: frame.height, : frame.width].copy())
    return frames, rate


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 4095), (np.uint16, 65535)])
@pytest.mark.parametrize("suffix", [".mkv", ".avi"])
def test_ffv1_is_lossless(tmp_path, dtype, top, suffix):
    frames = noisy_frames(dtype, top)
    path = tmp_path / f"video{suffix}"
    assert write_video(path, frames, fps_container=Fraction(30), codec="ffv1") == 7
    back, rate = decoded(path)
    assert rate == 30
    assert np.array_equal(np.stack(back), np.stack(frames))


@pytest.mark.parametrize(("codec", "suffix", "rms"), [("mjpeg", ".avi", 1.0), ("libx264", ".mp4", 2.0)])
def test_lossy_codecs_keep_the_full_range_of_counts(tmp_path, codec, suffix, rms):
    frames = smooth_frames()
    path = tmp_path / f"video{suffix}"
    rate = Fraction(30000, 1001)
    assert write_video(path, iter(frames), fps_container=rate, codec=codec) == 7
    back, found_rate = decoded(path)
    assert found_rate == rate
    error = np.stack(back).astype(float) - np.stack(frames)
    assert np.sqrt(np.mean(error**2)) < rms
    assert abs(error.mean()) < 0.2


def test_quality_scale_is_used_by_the_encoder(tmp_path):
    frames = noisy_frames(np.uint8, 255)
    sizes = []
    for quality in (2, 5, 20):
        path = tmp_path / f"q{quality}.avi"
        write_video(path, frames, fps_container=Fraction(30), quality=quality)
        data = path.read_bytes()
        table = data[data.index(b"\xff\xdb") + 5 :][:2]
        # FFmpeg scales MPEG's intra quantisation table, with 16 as first coefficient after the mean, by quality / 8.
        assert table[1] == 16 * quality // 8
        sizes.append(len(data))
    assert sizes[0] > sizes[1] > sizes[2]


@pytest.mark.parametrize(
    ("codec", "suffix"), [("mjpeg", ".avi"), ("ffv1", ".mkv"), ("libx264", ".mp4"), ("mjpeg", ".mkv")]
)
def test_same_frames_give_the_same_bytes(tmp_path, codec, suffix):
    rng = np.random.default_rng(12)
    frames = [
        np.clip(frame + 3.0 * rng.standard_normal(frame.shape), 0, 255).astype(np.uint8)
        for frame in smooth_frames(n=40)
    ]
    first = None
    for k in range(4):
        path = tmp_path / f"{k}{suffix}"
        # Fill memory differently, to detect an encoder that reads uninitialised memory.
        fill = [np.full(1000 * 2**i, 37 * k + i, dtype=np.uint8) for i in range(12)]
        del fill
        write_video(path, frames, fps_container=Fraction(25), codec=codec)
        first = first or path.read_bytes()
        assert path.read_bytes() == first


def test_invalid_frames_and_options_are_refused(tmp_path):
    path = tmp_path / "video.avi"
    rate = Fraction(30)
    with pytest.raises(ValueError, match="no frames"):
        write_video(path, [], fps_container=rate)
    with pytest.raises(ValueError, match="8 bit only"):
        write_video(path, noisy_frames(np.uint16, 4095), fps_container=rate)
    with pytest.raises(ValueError, match="multiples of 2"):
        write_video(path, noisy_frames(np.uint8, 255, shape=(41, 64)), fps_container=rate)
    with pytest.raises(ValueError, match="frame 1 is"):
        write_video(path, [np.zeros((4, 4), np.uint8), np.zeros((4, 6), np.uint8)], fps_container=rate)
    with pytest.raises(ValueError, match="gray"):
        write_video(path, [np.zeros((4, 4, 3), np.uint8)], fps_container=rate)
    with pytest.raises(ValueError, match="codec must be one of"):
        write_video(path, noisy_frames(np.uint8, 255), fps_container=rate, codec="vp9")
