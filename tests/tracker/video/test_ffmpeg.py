"""The FFmpeg reader: frame order, detection of damage, and rejection of other files with a reason."""

import re
from fractions import Fraction
from functools import partial

import av
import numpy as np
import pytest
from kit import camera_files as files
from kit import films as media

from tracker import TrackerSettings, flags, track
from tracker.video import UnreadableVideoError, VideoSource, probe
from tracker.video import source as limits

BLOB = TrackerSettings(fps=Fraction(1000), kind="blob")


read = partial(files.read, opened=VideoSource)


@pytest.mark.parametrize(
    ("codec", "suffix", "options", "reordered"),
    [
        ("libx264", "mp4", {"bf": "2"}, True),
        ("libx264", "mp4", {"bf": "0"}, False),
        ("libx264", "mkv", {"tune": "zerolatency"}, False),
        ("mjpeg", "avi", {}, False),
    ],
)
def test_frames_predicted_from_later_ones_are_recognised_by_their_order(
    codec, suffix, options, reordered, tmp_path
):
    """x264 with B frames (two at most, or none) and MJPG."""
    _, info = read(media.write(tmp_path / f"a.{suffix}", media.images(), codec=codec, options=options))
    assert info.reordered == reordered


@pytest.mark.parametrize("depth", [10, 12, 16])
def test_bit_depth_is_preserved(depth, tmp_path):
    images = media.images(4, depth=depth)
    name = f"gray{depth}le"
    frames, info = read(media.write(tmp_path / "a.mkv", images, codec="ffv1", pixel_format=name))
    assert info.bit_depth == depth
    assert frames[2].image.dtype == np.uint16
    assert np.array_equal(frames[2].image, images[2])


def test_rgb_is_converted_to_luma_without_rounding(tmp_path):
    images = media.images(3)
    frames, info = read(media.write(tmp_path / "a.mkv", images, codec="ffv1", pixel_format="bgr0"))
    assert info.bit_depth == 16
    assert np.array_equal(frames[1].image, images[1].astype(np.uint16) * 256)


def test_a_truncated_avi_is_read_up_to_its_end(tmp_path):
    path = media.write(tmp_path / "a.avi", media.images())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    frames, _ = read(path)
    good = [f for f in frames if f.image is not None]
    assert 10 <= len(good) < 40
    tracks = track(path, BLOB, recording="a")
    assert tracks
    assert np.isfinite(tracks.x_px[: len(good) - 1]).all()


def test_mp4_without_index_fails_with_that_reason(tmp_path):
    path = media.write(tmp_path / "a.mp4", media.images(), codec="libx264")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    failed = track(path, BLOB, recording="a")
    assert not failed
    assert "ended before its index" in failed.reason


@pytest.mark.parametrize(("codec", "suffix"), [("ffv1", "mkv"), ("mjpeg", "avi")])
def test_a_damaged_frame_is_nan_and_shifts_no_other(codec, suffix, tmp_path):
    path = media.write(tmp_path / f"a.{suffix}", media.images(), codec=codec)
    whole = track(path, BLOB, recording="a")
    media.damage_packet(path, 20)
    tracks = track(path, BLOB, recording="a")
    assert tracks
    assert len(tracks.time_s) == 40
    assert np.array_equal(tracks.time_s, whole.time_s)
    after = np.arange(40) > 20
    assert np.nanmax(np.abs(tracks.x_px[after] - whole.x_px[after])) < 0.05
    damaged = (tracks.flags[:, 0] & flags.DECODE_CORRUPT.value) > 0
    if codec == "ffv1":
        # Its check sums detect any damage; the state of its coder is unknown until the next key frame, 24.
        assert np.flatnonzero(damaged).tolist() == [20, 21, 22, 23]
        assert np.isnan(tracks.x_px[20, 0])
        assert tracks.decode.frames_corrupt == 4


def test_damage_of_a_predicted_frame_ends_at_the_next_key_frame(tmp_path):
    options = {"g": "20", "bf": "0"}
    path = media.write(tmp_path / "a.mp4", media.images(), codec="libx264", options=options)
    media.damage_packet(path, 5)
    frames, _ = read(path)
    assert len(frames) == 40
    missing = [k for k, f in enumerate(frames) if f.image is None]
    if missing:  # if the decoder detected it
        assert missing[0] in (5, 6)
        assert missing[-1] < 20


REJECTED = {
    "empty.mp4": (b"", "an empty file"),
    "text.mp4": (b"this is a text file and not a video\n" * 5, "a text file"),
    "photo.mp4": (b"\xff\xd8\xff\xe0" + bytes(200), "a JPEG image"),
    "zip.avi": (b"PK\x03\x04" + bytes(200), "a zip archive"),
    "list.avi": (b"ffconcat version 1.0\nfile other.avi\n", "a playlist"),
    "hls.avi": (b"#EXTM3U\nhttp://127.0.0.1:9/x.ts\n", "a playlist"),
    "noise.avi": (
        np.random.default_rng(1).integers(1, 255, 4000, dtype=np.uint8).tobytes(),
        "no readable format",
    ),
}


@pytest.mark.parametrize("name", REJECTED)
def test_other_files_are_rejected_with_their_apparent_type(name, tmp_path):
    content, looks_like = REJECTED[name]
    path = tmp_path / name
    path.write_bytes(content)
    failed = track(path, BLOB, recording=name)
    assert not failed
    assert "not a video (looks like" in failed.reason
    assert looks_like in failed.reason
    assert name in failed.reason


def test_a_file_with_audio_only_is_rejected(tmp_path):
    failed = track(media.write_sound(tmp_path / "a.mp4"), BLOB, recording="a")
    assert not failed
    assert "without a video stream" in failed.reason


def test_a_too_large_frame_is_rejected_before_decoding(tmp_path, monkeypatch):
    path = media.write(tmp_path / "a.avi", media.images(2))
    monkeypatch.setattr("tracker.video.source.TUNING", limits.Tuning(max_pixels=10_000))
    with pytest.raises(UnreadableVideoError, match="over the limit"):
        VideoSource(path)


def test_a_video_without_markers_fails_with_its_first_frame(tmp_path):
    flat = [np.full((120, 160), 128, np.uint8)] * 4
    failed = track(media.write(tmp_path / "a.mkv", flat, codec="ffv1"), BLOB, recording="a")
    assert not failed
    assert "no round dot" in failed.reason
    assert failed.first_frame.shape == (120, 160)


@pytest.mark.parametrize("times", [{"exposure_s": 2.0}, {"readout_s": -2.0}])
def test_times_longer_than_a_frame_are_refused(tmp_path, times):
    path = media.write(tmp_path / "a.mkv", media.images(4), codec="ffv1")
    failed = track(path, TrackerSettings(fps=Fraction(1000), kind="blob", **times), recording="a")
    key, value = next(iter(times.items()))
    assert f"{key} = {value:g} s is longer than the time between frames, 0.001 s" in failed.reason


def test_probe_counts_frames_without_decoding_them(tmp_path):
    report = probe(media.write(tmp_path / "a.mp4", media.images(), codec="libx264"))
    assert report.packets == 40
    assert report.stamps_missing == 0
    assert len(report.step_ticks) == 1
    assert report.first_frame.shape == (120, 160)


@pytest.mark.parametrize("size", [(161, 119), (17, 3), (1, 1), (8, 4001)])
def test_unusual_frame_sizes(size, tmp_path):
    width, height = size
    images = media.images(3, width=width, height=height)
    frames, info = read(media.write(tmp_path / "a.mkv", images, codec="ffv1"))
    assert (info.width_px, info.height_px) == size
    assert all(np.array_equal(f.image, i) for f, i in zip(frames, images, strict=True))
    tracks = track(tmp_path / "a.mkv", BLOB, recording="a")
    assert tracks or "no round dot" in tracks.reason or "small" in tracks.reason


def test_a_change_of_frame_size_is_rejected_with_the_frame_number(tmp_path):
    small = media.write(tmp_path / "small.avi", media.images(5, width=96, height=64))
    large = media.write(tmp_path / "large.avi", media.images(5))
    path = tmp_path / "both.mkv"
    with av.open(str(large)) as first, av.open(str(small)) as second, av.open(str(path), "w") as out:
        stream = out.add_stream_from_template(first.streams.video[0])
        for k, packet in enumerate([*first.demux(video=0), *second.demux(video=0)]):
            if packet.size:
                packet.stream, packet.pts, packet.dts = stream, k, k
                out.mux(packet)
    with pytest.raises(UnreadableVideoError, match="160 x 120 to 96 x 64 px at frame 5"):
        read(path)


@pytest.mark.parametrize("damaged", [[7], [7, 8], [11]])
def test_images_that_state_another_size_are_damaged_where_no_two_agree(tmp_path, damaged):
    path = media.write(tmp_path / "a.avi", media.images(12))
    data = bytearray(path.read_bytes())
    # The height of a JPEG image stands 5 bytes after the marker of its frame, a flipped bit makes it larger.
    heads = [match.start() for match in re.finditer(rb"\xff\xc0\x00\x11\x08\x00\x78\x00\xa0", data)]
    assert len(heads) == 12
    for bit, k in enumerate(damaged):
        data[heads[k] + 6] ^= 1 << bit
    path.write_bytes(data)
    frames, _ = read(path)
    assert [k for k, frame in enumerate(frames) if frame.image is None] == damaged


@pytest.mark.parametrize(("share", "first"), [(1.0, 0), (1.0, 30), (0.8, 0), (0.5, 30)])
def test_a_cut_matroska_file_is_noted(tmp_path, share, first):
    path = media.write(tmp_path / "a.mkv", media.images(), codec="ffv1", pts=range(first, first + 40))
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    report = probe(path)
    noted = [note for note in report.info.notes if "it is incomplete" in note]
    assert len(noted) == (share < 1.0)
    if noted:
        assert f"a length of {(first + 40) / 50:.4g} s" in noted[0]
        missing = float(noted[0].split("its images end ")[1].split(" s before")[0])
        assert missing == pytest.approx((40 - report.packets) / 50, abs=0.002), "ticks are of 1 ms"


def test_the_first_of_two_video_streams_is_read_with_a_note(tmp_path):
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as out:
        streams = [out.add_stream("ffv1", rate=50) for _ in range(2)]
        images = media.images(1)[0], media.images(1, width=64, height=48)[0]
        for stream, image in zip(streams, images, strict=True):
            stream.height, stream.width = image.shape
            stream.pix_fmt = "gray"
        for k in range(3):
            for stream, image in zip(streams, images, strict=True):
                frame = av.VideoFrame.from_ndarray(image, format="gray")
                frame.pts = k
                out.mux(stream.encode(frame))
        for stream in streams:
            out.mux(stream.encode(None))
    frames, info = read(path)
    assert (len(frames), info.width_px) == (3, 160)
    assert any("2 video streams" in note for note in info.notes)


def test_no_frame_that_depends_on_a_damaged_one_is_shown(tmp_path):
    # A key frame before the damaged packet leaves the decoder after it where frames in between depend on both.
    path = tmp_path / "film.mp4"
    images = media.images(20)
    media.write(path, images, codec="libx264", options={"g": "8"})
    clean = {frame.pts: frame.image for frame in read(path)[0]}
    for packet in range(1, len(images)):
        damaged = tmp_path / f"damaged_{packet}.mp4"
        damaged.write_bytes(path.read_bytes())
        frames = read(media.damage_packet(damaged, packet))[0]
        assert sorted(frame.pts for frame in frames) == sorted(clean), (
            f"packet {packet}: frames twice or missing"
        )
        assert any(frame.image is None for frame in frames), f"damage to packet {packet} is not seen"
        wrong = [
            f.pts for f in frames if f.image is not None and np.abs(f.image - 1.0 * clean[f.pts]).max() > 0.0
        ]
        assert not wrong, f"packet {packet}: frames at {wrong} depend on it, but are shown"
