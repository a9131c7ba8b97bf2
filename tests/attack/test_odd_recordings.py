"""Recordings whose header or name misleads: the images and their count decide, names are names."""

import os
import socket
import struct
from fractions import Fraction

import av
import numpy as np
import pytest
from kit import films as media

from modalcam.inputs import discover, probe_folder
from tracker import TrackerSettings, track
from tracker.video import UnreadableVideoError, open_recording

# Without a kind, `probe` would look for the codes of every dictionary in each frame, which takes most of its time.
KIND = '[markers]\nkind = "blob"\n'
PATCH = '[markers]\nkind = "patch"\npoints_px = [[16.0, 8.0]]\nsize_px = 9.0\n'
TURNS = {90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}
NAMES = [b"\xff\xfe.avi", b"new\nline.avi", b"tab\t.avi", b"esc\x1b[2J.avi", b"%02d.avi", b"-v.avi"]
NAMES += [b"a:b.avi", b"$1_$^.avi", b" space.avi", b"CON.avi", b"..avi", b"=cmd|' C'!A0.avi"]
NAMES += [b"<img src=x onerror=PWN=1>.avi", "\u202eright.avi".encode(), "\U0001f600.avi".encode()]
NAMES += [b"{{7*7}}.avi", b'"onload=.avi', b"x" * 251 + b".avi"]


def turned(path, degrees):
    """The MP4 file with a matrix that asks players to rotate the image."""
    data = bytearray(path.read_bytes())
    a, b, c, d = (65536 * value for value in TURNS[degrees])
    at = data.index(b"tkhd") + 44
    assert struct.unpack_from(">9i", data, at) == (65536, 0, 0, 0, 65536, 0, 0, 0, 2**30)
    struct.pack_into(">9i", data, at, a, b, 0, c, d, 0, 0, 0, 2**30)
    out = path.with_name(f"{degrees}.mp4")
    out.write_bytes(data)
    return out


@pytest.mark.parametrize("degrees", TURNS)
def test_a_request_to_rotate_changes_no_axis(tmp_path, degrees):
    images = media.images(3, width=96, height=48)
    path = media.write(tmp_path / "a.mp4", images, codec="libx264")
    plain, other = open_recording(path), open_recording(turned(path, degrees))
    for one, two in zip(plain.frames(), other.frames(), strict=True):
        assert np.array_equal(one.image, two.image)
    assert not plain.info.notes
    assert any("rotate the image" in note and "x along its rows" in note for note in other.info.notes)
    plain.close()
    other.close()


def test_pixels_that_are_not_square_and_interlaced_images_are_noted(tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=50, options={"x264-params": "interlaced=1"})
        stream.width, stream.height, stream.pix_fmt = 96, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        for image in media.images(3, width=96, height=48):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "gray").reformat(format="yuv420p")))
        container.mux(stream.encode())
    source = open_recording(path)
    assert [frame.image.shape for frame in source.frames()] == [(48, 96)] * 3
    notes = " ".join(source.info.notes)
    source.close()
    assert "aspect 4/3" in notes
    assert "interlaced" in notes


@pytest.mark.parametrize("declared", [0, 7, 2**32 - 1])
def test_frames_are_counted_whatever_the_header_states(tmp_path, declared):
    path = media.write(tmp_path / "a.avi", media.images(12, width=64, height=48))
    data = bytearray(path.read_bytes())
    for name, offset in ((b"avih", 24), (b"strh", 40)):
        struct.pack_into("<I", data, data.index(name) + offset, declared)
    path.write_bytes(data)
    (tmp_path / "experiment.toml").write_text(KIND)
    (probed,) = probe_folder(path, follow_symlinks=False)
    assert (probed.packets, probed.frames_declared) == (12, declared)
    tracks = track(path, TrackerSettings(fps=100, kind="blob"))
    assert tracks.time_s.size == 12


REFERENCES = {
    "concat.avi": "ffconcat version 1.0\nfile '{url}'\n",
    "hls.mp4": "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{url}\n",
    "dash.mkv": '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><BaseURL>{url}</BaseURL></MPD>',
    "sdp.mov": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nm=video {port} RTP/AVP 96\n",
}


@pytest.mark.parametrize("name", REFERENCES)
def test_references_are_refused_without_a_request(tmp_path, name):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        path = tmp_path / name
        path.write_text(REFERENCES[name].format(url=f"http://127.0.0.1:{port}/take.avi", port=port))
        with pytest.raises(UnreadableVideoError, match="not a video"):
            open_recording(path)
        server.setblocking(False)
        with pytest.raises(BlockingIOError):
            server.accept()


def test_a_movie_whose_images_are_in_another_file_has_none(tmp_path):
    other = media.write(tmp_path / "other.mov", media.images(12), codec="mpeg4")
    path = tmp_path / "a.mov"
    data = other.read_bytes()
    # The data reference "in this file" becomes a URL of another one; the images themselves are overwritten.
    at = data.index(b"url \x00\x00\x00\x01")
    start = data.index(b"mdat") + 4
    stop = data.index(b"moov") - 4
    changed = data[:start] + bytes(stop - start) + data[stop:at] + b"url \x00\x00\x00\x00" + data[at + 8 :]
    path.write_bytes(changed)
    tracks = track(path, TrackerSettings(fps=100, kind="blob"))
    assert not tracks


def test_names_of_every_kind_are_read_and_shown(tmp_path):
    folder = tmp_path / "videos"
    folder.mkdir()
    (folder / "experiment.toml").write_text(PATCH)
    whole = media.write(tmp_path / "a.avi", media.images(2, width=32, height=16)).read_bytes()
    for name in NAMES:
        (folder / os.fsdecode(name)).write_bytes(whole)
    found = discover(folder).recordings
    # A name that begins with a point and has no other is hidden, not a recording.
    assert {os.fsencode(recording.file) for recording in found} == set(NAMES)
    assert len({recording.name.casefold() for recording in found}) == len(NAMES)
    assert all(recording.name.isascii() and "/" not in recording.name for recording in found)
    probes = probe_folder(folder, follow_symlinks=False)
    assert [p.packets for p in probes] == [2] * len(NAMES)
    assert not [p.file for p in probes if p.problem]
