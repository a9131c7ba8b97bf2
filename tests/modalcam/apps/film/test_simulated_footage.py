"""Simulated footage of a recording: its frames, the positions of the simulated markers, its display."""

import base64
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from kit.films import write
from kit.identified import identification
from kit.series import pole_of
from kit.tracks import decoded, tracks_of
from support.render_truth import centroid

from modalcam.apps.film import (
    KeptFrames,
    SimulatedFootage,
    chosen_rows,
    film,
    film_simulation,
    read_kept_frames,
    reduced,
)
from modalcam.config import RecordingConfig
from modalcam.report.style import environment
from sim import paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping
from tracker import Failure, Scale

POSITIONS_MM = np.array([100.0, 250.0, 400.0, 490.0])
FPS, SCALE, RATIO, TIP_MM = 250.0, 0.8, 0.02, 1.0
# Clamp at (x, y) in px, direction of the hanging beam and of its positive motion in the image: upright camera,
# camera on its side, and the same mirrored.
VIEWS = {
    "upright": ((30.0, 20.0), (0.0, 1.0), (1.0, 0.0)),
    "on its side": ((20.0, 40.0), (1.0, 0.0), (0.0, -1.0)),
    "mirrored": ((20.0, 40.0), (1.0, 0.0), (0.0, 1.0)),
}


def recorded(view, frames=400):
    """Tracks and identification of a decay in mode 2 by linear theory, in the image of a camera."""
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 4)
    frequency = float(modes.frequency_hz[1])
    shape = modes.transverse_at(POSITIONS_MM * 1e-3)[:, 1]
    shape = TIP_MM * shape / shape[-1]
    time_s = np.arange(frames) / FPS
    (x0, y0), along, across = VIEWS[view]
    # y is up in mm; the direction sets the sign of the series
    found = identification(
        [(frequency, RATIO, shape, 2)],
        time_s=time_s,
        positions_mm=POSITIONS_MM,
        fit_from_s=0.0,
        direction=(across[0], -across[1]),
    )
    moved = np.real(np.exp(pole_of(frequency, RATIO) * time_s)[:, None] * shape) / SCALE
    rest = POSITIONS_MM / SCALE
    x, y = (o + rest * a + moved * c for o, a, c in zip((x0, y0), along, across, strict=True))
    size = [int(v) for v in np.ceil([x.max() + 30, y.max() + 30])]
    given = {"scale": Scale(SCALE, 0.0, "user"), "decode": decoded(frames, size=size)}
    tracks = tracks_of(x, y, fps=FPS, recording="take", positions_mm=POSITIONS_MM, **given)
    return tracks, found


def blank_footage(tracks, found, noise_sd=0.0):
    rows = chosen_rows(tracks.time_s, 0.0, found.target)
    shape = (rows.size, tracks.decode.height_px, tracks.decode.width_px)
    images, time_s = np.full(shape, 200, np.uint8), tracks.time_s[rows]
    return KeptFrames("take", rows, time_s, images, 1, 0, 0, noise_sd, 1.0 / found.target.frequency_hz)


def filmed(view, recording=None, kind="blob", **changes):
    tracks, found = recorded(view)
    tracks = replace(tracks, kind=kind)
    footage = replace(blank_footage(tracks, found), **changes)
    # The foreground is read from the images, so a dark dot is drawn at each marker.
    images = footage.images.copy()
    for image, row in zip(images, footage.frame, strict=True):
        for x, y in zip(tracks.x_px[row], tracks.y_px[row], strict=True):
            cv2.circle(image, (round(x), round(y)), 7, 30, -1)
    recording = recording or RecordingConfig(file="take.avi", kind="blob", size_mm=10.0)
    drawn, law = replace(footage, images=images), GenericDamping((RATIO, RATIO))
    given = {"highest_mode": 2, "rng": np.random.default_rng(3)}
    made = film_simulation(drawn, tracks, found, recording, paper_beam(), law, **given)
    return tracks, footage, made


@pytest.mark.parametrize("view", VIEWS)
def test_simulated_dots_follow_linear_theory_in_every_view(view):
    tracks, footage, simulated = filmed(view)
    assert isinstance(simulated, SimulatedFootage)
    upright = VIEWS[view][1] == (0.0, 1.0)
    for image, row in zip(simulated.images[::5], footage.frame[::5], strict=True):
        for x, y in zip(tracks.x_px[row], tracks.y_px[row], strict=True):
            # Each line of pixels across the dot is symmetric about its centre; within them, the dot covers the beam.
            reach_x, reach_y = (12, 4) if upright else (4, 12)
            left, top = round(x) - reach_x, round(y) - reach_y
            part = image[top : top + 2 * reach_y + 1, left : left + 2 * reach_x + 1].astype(float)
            at = centroid(part, 200.0)
            found, true = (at[0] + left, x) if upright else (at[1] + top, y)
            # Rounding of pixels (sd 0.29) moves it by 0.0015 px; the rest are the effects named below.
            assert abs(found - true) < 0.02, (view, row)
    # Large rotation and the interpolation between the steps each contribute about 1e-3 of the amplitude.
    assert simulated.difference_mm < 2e-3 * TIP_MM
    assert 0.3 * TIP_MM < simulated.largest_mm < 0.7 * TIP_MM


def test_simulated_footage_has_the_noise_of_the_recording():
    _, _, simulated = filmed("upright", noise_sd=3.0)
    still = simulated.images[:, :, :8].astype(float)
    # Rounding adds a variance of 1/12; no marker reaches the left edge.
    expected = np.sqrt(9.0 + 1.0 / 12.0)
    assert abs(still.std() / expected - 1.0) < 5.0 / np.sqrt(2.0 * still.size)


@pytest.mark.parametrize(
    ("recording", "kind", "words"),
    [
        (RecordingConfig(file="take.avi"), "blob", "size_mm is needed"),
        (RecordingConfig(file="take.avi", size_mm=1e6), "blob", "mm that the image shows"),
        (RecordingConfig(file="take.avi", size_mm=10.0), "patch", "kind 'patch' have no known picture"),
        (RecordingConfig(file="take.avi"), "line", "kind 'line' have no known picture"),
    ],
)
def test_markers_that_cannot_be_rendered_give_a_reason(recording, kind, words):
    _, _, simulated = filmed("upright", recording, kind)
    assert isinstance(simulated, Failure)
    assert words in simulated.reason


def test_frames_cover_whole_periods_from_half_the_amplitude_on():
    _, found = recorded("upright")
    mode = found.target
    time_s = np.arange(4000) / 1000.0
    rows = chosen_rows(time_s, 0.5, mode)
    assert len(set(np.diff(rows))) == 1
    assert rows.size <= 28
    half_s = np.log(2.0) / (2.0 * np.pi * mode.frequency_hz * mode.damping_ratio)
    assert time_s[rows[0]] == pytest.approx(0.5 + half_s, abs=1e-3)
    periods = rows.size * (rows[1] - rows[0]) * 1e-3 * mode.frequency_hz
    # Within half a step between the frames.
    assert abs(periods - round(periods)) <= 0.5 * (rows[1] - rows[0]) * 1e-3 * mode.frequency_hz
    # A recording that ends earlier is shown to its end.
    short = chosen_rows(time_s[:700], 0.5, mode)
    assert short[-1] == 699
    assert short[0] >= 500
    # The exposure of a frame at the onset would begin before the motion that was fitted.
    assert chosen_rows(time_s[:600], 0.5, mode)[0] == 501


def test_footage_is_cropped_and_reduced_and_its_noise_is_estimated(tmp_path):
    tracks, found = recorded("upright", frames=120)
    height, width = tracks.decode.height_px, tracks.decode.width_px
    rng = np.random.default_rng(5)
    images = np.clip(np.rint(180 + 2.5 * rng.standard_normal((120, height, width))), 0, 255).astype(np.uint8)
    path = tmp_path / "take.mkv"
    write(path, images, codec="ffv1", rate=30)
    footage = read_kept_frames(path, tracks, found, 10.0)
    assert isinstance(footage, KeptFrames)
    n, h, w = footage.images.shape
    bottom, right = footage.top_px + h * footage.shrink, footage.left_px + w * footage.shrink
    window = images[footage.frame, footage.top_px : bottom, footage.left_px : right].astype(float)
    assert np.array_equal(footage.images, np.rint(reduced(window, footage.shrink)))
    assert np.all((tracks.y_px - footage.top_px > 8.0) & (bottom - tracks.y_px > 8.0))
    assert np.array_equal(footage.time_s, tracks.time_s[footage.frame])
    # The median over the pixels of variances with n - 1 degrees of freedom scatters by 1.25 sqrt(2 / (n - 1) / pixels);
    # Wilson and Hilferty's approximation of it is off by 2e-3 at 20 degrees of freedom.
    scatter = 0.5 * 1.25 * np.sqrt(2.0 / (n - 1) / (h * w * footage.shrink**2))
    assert abs(footage.noise_sd / 2.5 - 1.0) < 5.0 * scatter + 2e-3
    missing = read_kept_frames(tmp_path / "none.mkv", tracks, found, 10.0)
    assert isinstance(missing, Failure)
    assert "none.mkv" in missing.reason


def test_reduction_is_the_mean_over_blocks():
    film = np.arange(2 * 4 * 6, dtype=float).reshape(2, 4, 6)
    assert reduced(film, 2)[1, 1, 2] == film[1, 2:4, 4:6].mean()
    assert np.array_equal(reduced(film, 1), film)


@pytest.mark.parametrize("view", ["upright", "on its side"])
def test_the_film_is_small_and_its_sheet_has_the_frames_in_order(view):
    _, footage, simulated = filmed(view, noise_sd=2.0)
    shown = film(footage, simulated)
    assert sum(map(len, (shown["sheet"], *shown["close_ups"]))) < 300_000
    data = base64.b64decode(shown["sheet"].partition(",")[2])
    sheet = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    width, count = shown["width"], shown["frames"]
    assert sheet.shape == (shown["height"], count * width)
    k = count // 2
    frame = sheet[:, k * width : (k + 1) * width].astype(float)
    h, w = simulated.images.shape[1:]
    part = frame[:, -w:] if h >= w else frame[-h:]
    # The sheet is compressed with losses: the limit allows for noise and lost detail, not for another frame's dots.
    assert np.sqrt(np.mean((part - simulated.images[k]) ** 2)) < 4.0
    assert film(footage, simulated) == shown
    html = environment(("modalcam.apps.film", "templates")).from_string(
        '{% import "parts.html.j2" as part with context %}{% include "footage.html.j2" %}'
    )
    text = html.render(
        view=shown | {"footage": simulated, "shown_per_s": 12.0, "close_up_px": 176}, id="a", methods={}
    )
    times = re.search(r"([\d.]+) times slower than recorded", text)
    assert float(times[1]) == pytest.approx(FPS / (footage.frame[1] - footage.frame[0]) / 12.0, rel=0.05)
    largest = re.search(r"Largest amplitude ([\d.]+) mm", text)
    assert float(largest[1]) == pytest.approx(simulated.largest_mm, rel=0.05)
    assert ("left measured" if view == "upright" else "top measured") in text
