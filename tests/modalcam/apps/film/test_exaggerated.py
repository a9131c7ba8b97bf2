"""The line of a recording re-posed by its mode: where it is in each frame, and what is left where it was."""

from dataclasses import replace

import av
import numpy as np
import pytest
from kit import runs
from PIL import Image
from support.html_page import Page

from modalcam.apps.film import FRAMES, ExaggeratedFilm, exaggerated_film, marker_film, write_film
from modalcam.report import build_report
from modalcam.tables import summary

STATIONS = 60
BRIGHT, DARK = 180.0, 60.0


@pytest.fixture(scope="module")
def recording():
    """A dark vertical strip in front of an even background, followed at 60 stations."""
    names = tuple(f"s{k + 1}" for k in range(STATIONS))
    positions_mm = np.linspace(20.0, 480.0, STATIONS)
    made = runs.recording(0, number=2, markers=names, positions_mm=positions_mm, seconds=1.5)
    tracks = made.tracks
    rows, columns = np.indices(tracks.first_frame.shape)
    seen = np.isfinite(tracks.x_px[0] + tracks.y_px[0])
    middle = np.interp(rows[:, 0], tracks.y_px[0, seen], tracks.x_px[0, seen])
    image = BRIGHT - (BRIGHT - DARK) * np.exp(-0.5 * ((columns - middle[:, None]) / 1.5) ** 2)
    return replace(made, tracks=replace(tracks, kind="line", first_frame=np.rint(image).astype(np.uint8)))


def centroid(image, row):
    dark = np.maximum(BRIGHT - image[row].astype(float) - 4.0, 0.0)
    return float(dark @ np.arange(dark.size) / dark.sum())


def test_the_line_moves_by_the_factor_times_the_shape(recording):
    tracks, found = recording.tracks, recording.identification
    mode = found.target
    film = exaggerated_film(tracks, found, mode, factor=3.0)
    assert isinstance(film, ExaggeratedFilm)
    assert film.images.shape[0] == FRAMES
    assert film.largest_px == pytest.approx(3.0 * np.max(np.abs(mode.shape)), rel=1e-9), "1 mm is 1 px"
    turned = mode.shape * np.exp(-1j * np.angle(mode.shape[np.argmax(np.abs(mode.shape))]))
    for k in range(2, STATIONS - 2, 9):
        row = round(20.0 + found.series.positions_mm[k])
        there, back = (centroid(film.images[i], row) for i in (0, FRAMES // 2))
        # Rounded gray levels at some 8 pixels, linear interpolation of a profile of sd 1.5 px: below 0.1 px each.
        assert there - back == pytest.approx(6.0 * turned[k].real, abs=0.2), f"station {k}"


def test_what_the_line_uncovers_is_the_background(recording):
    tracks, found = recording.tracks, recording.identification
    film = exaggerated_film(tracks, found, found.target, factor=4.0)
    row = round(20.0 + found.series.positions_mm[-3])
    at = round(centroid(film.images[0], row))
    away = np.ones(film.images.shape[2], dtype=bool)
    away[max(0, at - 8) : at + 9] = False
    # The profile's tail within the 9 px at which the background is taken, and rounding.
    assert np.max(np.abs(film.images[0, row, away].astype(float) - BRIGHT)) <= 2.0


def test_the_factor_is_chosen_from_the_length(recording):
    tracks, found = recording.tracks, recording.identification
    film = exaggerated_film(tracks, found, found.target)
    # 4 mm at 1 mm/px: 8 % of 460 px are 36.8 px
    assert film.factor == 5.0
    small = replace(found.target, shape=1e-3 * found.target.shape)
    assert exaggerated_film(tracks, found, small).factor == 5000.0


def test_only_lines_are_posed(recording):
    found = recording.identification
    for tracks in (replace(recording.tracks, kind="blob"), replace(recording.tracks, first_frame=None)):
        made = exaggerated_film(tracks, found, found.target)
        assert not made
        assert "line" in made.reason


def test_the_written_film_repeats_the_cycle_and_is_reproducible(recording, tmp_path):
    film = exaggerated_film(recording.tracks, recording.identification, recording.identification.target)
    short = replace(film, images=film.images[::6])
    for name in ("a.mp4", "b.mp4"):
        count = write_film(tmp_path / name, short, "Mode 2")
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert len(list(container.decode(video=0))) == count == 5 * 4
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_gif_holds_the_gray_levels_of_the_film(recording, tmp_path):
    """Read by Pillow, whose decoder is its own."""
    film = exaggerated_film(recording.tracks, recording.identification, recording.identification.target)
    short = replace(film, images=film.images[::6])
    for name in ("a.gif", "b.gif"):
        assert write_film(tmp_path / name, short, "Mode 2") == 5 * 4
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    with Image.open(tmp_path / "a.gif") as read:
        assert read.n_frames == 5 * 4
        read.seek(6)
        shown = np.asarray(read.convert("L"))
    image = short.images[2]
    # Pillow's gray of three equal levels, and that of the encoder, are off by one at most.
    part = shown[-image.shape[0] :, (shown.shape[1] - image.shape[1]) // 2 :][:, : image.shape[1]]
    assert np.max(np.abs(part.astype(int) - image)) <= 1


def test_markers_are_drawn_where_the_mode_moves_them():
    made = runs.recording(0, number=2, seconds=1.5)
    tracks, found = made.tracks, made.identification
    film = marker_film(tracks, found, found.target, factor=20.0)
    assert film.images.shape[0] == FRAMES
    assert film.largest_px == pytest.approx(20 * np.max(np.abs(found.target.shape)), rel=1e-9), "1 mm is 1 px"
    shape = found.target.shape
    shape = shape * np.exp(-1j * np.angle(shape[np.argmax(np.abs(shape))]))
    margin = np.array(film.images.shape[1:]) - tracks.first_frame.shape
    for k in range(len(found.series.channels)):
        at = np.array([np.nanmedian(tracks.y_px[:, k]), np.nanmedian(tracks.x_px[:, k])]) + margin // 2
        # motion along x in the image, to the right
        for i, sign in ((0, 1.0), (FRAMES // 2, -1.0)):
            moved = np.array([0.0, sign * 20.0 * shape[k].real * found.series.direction[0]])
            row, column = np.rint(at + moved).astype(int)
            disc = film.images[i, row - 2 : row + 3, column - 2 : column + 3]
            assert disc.min() == 255, f"a disc of 4 px stands at marker {k} in frame {i}"
    assert film.images.max(axis=0).mean() < 128.0, "the rest is darkened"
    assert marker_film(tracks, found, found.target).factor in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def test_markers_without_a_frame_or_a_shape_are_not_drawn():
    made = runs.recording(0, seconds=1.5)
    tracks, found = made.tracks, made.identification
    assert "no first frame" in marker_film(replace(tracks, first_frame=None), found, found.target).reason
    flat = replace(found.target, shape=np.full(found.target.shape.shape, np.nan + 0j))
    assert "fewer than two" in marker_film(tracks, found, flat).reason


def test_the_report_of_a_line_shows_its_motion_and_few_of_its_stations(recording):
    result = runs.run_result([recording])
    html = build_report(result)
    page = Page(html)
    assert all(v.startswith("data:image/") for v in page.values("src"))
    assert {"r1-exaggerated", "r1-waterfall", "r1-shape"} <= set(page.values("id"))
    assert "6 of 60 stations are listed" in html
    assert html.count('<tr><th scope="row"><bdi>s') == 6
    # mode 2 of a cantilever (Blevins, table 8-1); gravity moves its node by less than 1 %
    (node,) = summary(result)["recordings"][0]["modes"][0]["nodes"]
    assert node["position_mm"] == pytest.approx(0.7834 * 500.0, rel=0.01)
    assert "Node at" in page.words
    other = build_report(runs.run_result([runs.recording(0, seconds=1.5)]))
    assert 'id="r1-exaggerated"' not in other
    assert 'id="r1-waterfall"' not in other
