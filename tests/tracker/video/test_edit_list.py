"""Edit lists of MP4 files: the frames that players show are used, at the times at which they were recorded."""

import av
import numpy as np
import pytest
from kit import films as media

from tracker import TrackerSettings, track
from tracker.video import VideoSource, probe

RATE = 250
# One frame of 1/250 s in ticks, as FFmpeg writes MP4 of that rate.
TICKS = 16000 // RATE
COUNT = 60
CODING = {
    "I and P": {"bf": "0", "g": "12"},
    "B": {"bf": "2", "g": "12"},
    "one key frame": {"bf": "3", "g": "250"},
}


def first_ticks(path):
    """Time of the first frame in the recording's own time, which the edit list of the writer states."""
    data = path.read_bytes()
    at = data.index(b"elst") + 16
    return int.from_bytes(data[at : at + 4], "big")


def read(path):
    """Numbers in the frames, their stamps, and the properties of the recording."""
    source = VideoSource(path)
    frames = list(source.frames())
    source.close()
    return [media.number_in(f.image) for f in frames], [f.pts for f in frames], source.info


def shown_by_ffmpeg(path):
    with av.open(str(path)) as container:
        return [media.number_in(f.to_ndarray(format="gray")) for f in container.decode(video=0)]


# Parts that are shown, in frames: (first, number, rate); -1 is an empty part.
LISTS = {
    "pre-roll": [(17, 43, 1.0)],
    "end cut away": [(0, 40, 1.0)],
    "jump": [(5, 15, 1.0), (40, 15, 1.0)],
    "starts later": [(-1, 25, 1.0), (20, 30, 1.0)],
    "half speed": [(20, 30, 0.5)],
}


@pytest.fixture(params=CODING, scope="module")
def film(request, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / "a.mp4"
    options = CODING[request.param]
    return media.write(path, media.numbered(COUNT), codec="libx264", rate=RATE, options=options)


@pytest.mark.parametrize("name", LISTS)
def test_the_frames_that_players_show_are_used(film, name, tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(film.read_bytes())
    start = first_ticks(path)
    media.edit(
        path,
        [(4 * count, -1 if first < 0 else start + TICKS * first, rate) for first, count, rate in LISTS[name]],
    )
    expected = [k for first, count, _ in LISTS[name] if first >= 0 for k in range(first, first + count)]
    numbers, stamps, info = read(path)
    assert numbers == expected == shown_by_ffmpeg(path)
    assert np.array_equal(np.diff(stamps), TICKS * np.diff(expected)), (
        "at the recorded times, not those of playback"
    )
    assert info.frames_declared == len(expected)
    assert (
        f"{COUNT - len(expected)} of {COUNT} frames in the file are hidden by its edit list" in info.notes[-1]
    )
    source = VideoSource(path)
    # In order of decoding.
    assert sorted(source.stamps()) == stamps
    source.close()
    report = probe(path)
    assert (report.packets, report.info.frames_declared) == (len(expected), len(expected))
    assert report.info.notes == info.notes


def test_an_edit_list_that_hides_nothing_changes_nothing(film):
    """Its writer states one where the first frame is not the first to be decoded."""
    numbers, _, info = read(film)
    assert numbers == list(range(COUNT))
    assert info.notes == ()


def test_an_edit_list_that_shows_nothing_is_ignored(film, tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(film.read_bytes())
    numbers, _, info = read(media.edit(path, [(4, 10**8, 1.0)]))
    assert numbers == list(range(COUNT))
    assert "shows none of its frames" in info.notes[-1]


def test_a_film_that_is_cut_off_has_no_hidden_frames(film, tmp_path):
    """The index comes first and declares frames that are not there: they are missing, not hidden."""
    path = tmp_path / "a.mp4"
    with av.open(str(film)) as source, av.open(str(path), "w", options={"movflags": "faststart"}) as copy:
        stream = copy.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                copy.mux(packet)
    path.write_bytes(path.read_bytes()[: int(0.8 * path.stat().st_size)])
    source = VideoSource(path)
    assert 10 < len(list(source.frames())) < COUNT
    info = source.info
    assert not any("hidden" in note for note in info.notes)


def test_hidden_frames_do_not_reach_the_template(tmp_path):
    """Pre-roll of another scene and a jump: tracks of the frames shown, at their recorded times."""
    scene = media.images(COUNT)
    rng = np.random.default_rng(5)
    other = [rng.integers(0, 256, scene[0].shape, dtype=np.uint8) for _ in range(12)]
    images = other + scene[:20] + other[:6] + scene[26:]
    path = media.write(
        tmp_path / "a.mp4", images, codec="libx264", rate=RATE, options={"bf": "0", "crf": "10"}
    )
    start, tail = first_ticks(path), COUNT - 26
    media.edit(path, [(80, start + 12 * TICKS, 1.0), (4 * tail, start + 38 * TICKS, 1.0)])
    tracks = track(path, TrackerSettings(kind="blob", fps=1000), recording="a")
    true_frame = np.array([*range(20), *range(26, COUNT)])
    assert np.allclose(tracks.time_s * 1000, true_frame)
    swing = 5.0 * np.sin(0.5 * true_frame)
    # The dot swings as 5 sin(0.5 k) px; compression at crf 10 costs hundredths of a pixel.
    assert np.ptp(tracks.x_px[:, 0] - swing) < 0.3
    assert any("18 of 72 frames in the file are hidden" in note for note in tracks.notes)
