"""Conversions of the frame rate: recognised in series that are converted, and in no others."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from kit.series import QUICK, decay, series_of

from benchmarks.converted_rates import ConvertedCase, answer, cases, outcome
from benchmarks.film_scenes import Film
from modal_id import IdentifySettings, ModeFlag, identify
from modal_id.data import prepare
from modal_id.fit import find_modes
from modal_id.modes import conversion
from tracker import displacement_series, track

FLAG = ModeFlag.RATE_CONVERTED.name
AT_ONCE = IdentifySettings(onset_s=0.0, sampler=QUICK)


def one_mode(fps, frequency_hz, places, noise, seed):
    """A decay seen by two channels at these places, in recorded frames, stored as evenly spaced frames."""
    pole = 2 * np.pi * frequency_hz / fps * complex(-0.004, 1.0)
    motion = np.exp(pole * places).real[:, None] * np.array([1.0, 0.6])
    rng = np.random.default_rng(seed)
    return series_of(np.arange(places.size) / fps, motion + noise * rng.standard_normal(motion.shape))


@pytest.mark.parametrize(
    ("step", "ratio"), [(5, 5 / 4), *(pytest.param(n, n / (n - 1), marks=pytest.mark.slow) for n in (10, 25))]
)
def test_frames_left_out_are_recognised_and_side_bands_are_no_modes(step, ratio):
    places = np.arange(1500)
    places = places[places % step != step - 1]
    found = identify(one_mode(500.0, 40.0, places, 0.01, step), AT_ONCE)
    assert [mode.frequency_hz for mode in found.modes] == pytest.approx([40.0 * ratio], rel=1e-3), (
        "frames without every n-th make all frequencies n / (n - 1) times too high; its side bands are no modes"
    )
    (mode,) = found.modes
    assert FLAG in mode.flags
    # The note states the frequency with the ratio divided out to four digits.
    (note,) = [note for note in mode.notes if note.startswith("Frames fit a converted rate")]
    stated_hz = float(note.split("the frequency is ")[1].split()[0])
    # The pattern is known to a quarter of a cycle in 1200 frames, 2e-4, and four digits are stated, 1.25e-4.
    assert stated_hz == pytest.approx(mode.frequency_hz / ratio, rel=3.3e-4), note
    assert all("side band" in failed.reason for failed in found.failed)


def test_lost_frames_are_not_taken_for_inserted_ones():
    """The times of the frames between decide: they are those of the rows."""
    series = one_mode(500.0, 40.0, np.arange(1200), 0.01, 1)
    values = series.values.copy()
    values[np.arange(7, 1200, 12)] = np.nan
    found = identify(replace(series, values=values), AT_ONCE)
    assert FLAG not in found.target.flags
    assert abs(found.target.frequency_hz - 40.0) < 4.0 * found.target.frequency_sd_hz


def test_doubled_frames_are_recognised_where_they_are_left_out_of_the_series():
    places = np.repeat(np.arange(1200), 1 + (np.arange(1200) % 6 == 5))
    series = one_mode(500.0, 40.0, places, 0.01, 1)
    values = np.where(np.diff(places, prepend=-1)[:, None] > 0, series.values, np.nan)
    found = identify(replace(series, values=values), AT_ONCE)
    assert FLAG in found.target.flags


def test_a_frequency_that_depends_on_the_amplitude_is_no_conversion():
    time_s = np.arange(1000) / 250.0
    amplitude = np.exp(-1.2 * time_s)
    phase = 2 * np.pi * 40.0 * (time_s + 0.01 * (1 - amplitude**2) / 2.4)
    noise = 0.005 * np.random.default_rng(2).standard_normal((1000, 2))
    series = series_of(time_s, (amplitude * np.cos(phase))[:, None] * np.array([1.0, 0.6]) + noise)
    assert FLAG not in identify(series, AT_ONCE).target.flags


def test_noise_that_flickers_is_no_conversion():
    """Light that flickers changes the noise by any factor; a mean of two frames has at least half of the variance."""
    series = one_mode(500.0, 40.0, np.arange(2000), 0.0, 1)
    size = 0.01 * (1.0 + 0.8 * np.sin(2 * np.pi * 0.2 * np.arange(2000)))
    noise = size[:, None] * np.random.default_rng(3).standard_normal((2000, 2))
    found = identify(replace(series, values=series.values + noise), AT_ONCE)
    assert FLAG not in found.target.flags


def test_a_pattern_at_three_times_the_frequency_is_recognised():
    """No coincidence hides a conversion: over 1433 frames, the two differ by 0.2 of a cycle."""
    case = ConvertedCase("blended up", 15, 1)
    assert answer(case.record()[0], np.nan) == ("flagged", FLAG)


def double_image_px(first_px, second_px, weight, width_px=3.0):
    """Position of a Gaussian spot in a blended frame: where its template correlates best with the double image."""
    place = (1.0 - weight) * first_px + weight * second_px
    for _ in range(20):
        near = (1.0 - weight) * np.exp(-(((place - first_px) / width_px) ** 2) / 4.0)
        far = weight * np.exp(-(((place - second_px) / width_px) ** 2) / 4.0)
        place = (near * first_px + far * second_px) / (near + far)
    return place


@pytest.mark.parametrize(
    "ratio", [5 / 4, *(pytest.param(ratio, marks=pytest.mark.slow) for ratio in (4 / 3, 4 / 5))]
)
def test_errors_of_double_images_hide_no_conversion(ratio):
    """The spot moves by 1.6 px per recorded frame; the error of its position is up to 0.02 px."""
    frames = np.arange(1200)
    swing = 6.0 * np.exp(2 * np.pi * 10.577 / 250.0 * complex(-0.005, 1.0) * frames).real
    place = ratio * np.arange(int((frames.size - 2) / ratio))
    first = np.floor(place + 1e-9).astype(np.intp)
    weight = np.maximum(place - first, 0.0)
    seen = double_image_px(swing[first], swing[first + 1], weight)[:, None] * np.array([1.0, 0.33])
    rng = np.random.default_rng(1)
    recorded = 0.004 * rng.standard_normal((frames.size, 2))
    seen += (1.0 - weight)[:, None] * recorded[first] + weight[:, None] * recorded[first + 1]
    target = identify(series_of(np.arange(place.size) / 250.0, seen), AT_ONCE).target
    assert FLAG in target.flags
    (note,) = [note for note in target.notes if note.startswith("Frames fit a converted rate")]
    # Four digits are stated; the pattern is known to a quarter of a cycle in 900 frames, 3e-4.
    assert float(note.split(": ")[1].split()[0]) == pytest.approx(ratio, rel=4e-4), note


def test_noise_that_follows_the_motion_is_no_conversion():
    """Errors of positions grow with the speed, whose square has twice the frequency of the motion."""
    series = one_mode(500.0, 40.0, np.arange(2000), 0.0, 1)
    speed = np.sin(2 * np.pi * 40.0 / 500.0 * np.arange(2000))
    noise = 0.005 * (1.0 + 2.0 * speed**2)[:, None] * np.random.default_rng(3).standard_normal((2000, 2))
    found = identify(replace(series, values=series.values + noise), AT_ONCE)
    assert FLAG not in found.target.flags


@pytest.mark.parametrize(
    ("kind", "px", "seed"),
    [
        ("aruco", 5.0, 108),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("aruco", 1.0, 11), ("patch", 0.3, 107))),
    ],
)
def test_frames_that_a_codec_predicts_are_no_conversion(tmp_path, kind, px, seed):
    """Errors of frames that H.264 predicts from others alternate, or have other periods, as those of blends."""
    film = Film(kind, "H.264", px, 1500, seed)
    tracks = track(film.write(tmp_path), film.settings(), recording="film")
    target = identify(displacement_series(tracks, unit="px"), AT_ONCE).target
    assert FLAG not in target.flags
    assert abs(target.frequency_hz - film.truth().frequency_hz) < 4.0 * target.frequency_sd_hz


# Frames that are left out are recognised in the first test of this file, too.
# The side bands of doubled 4, seed 3, and blended up 50, seed 3, divide the record in parts too short for a pattern.
MORE = [("left out", 25, 0), ("blended up", 10, 0), ("blended up", 50, 3), ("blended up", 2, 4)]
MORE = [pytest.param(*case, marks=pytest.mark.slow) for case in (*MORE, ("doubled", 4, 3))]
SOME = [("blended down", 5, 0), ("doubled", 5, 0), *MORE]


@pytest.mark.parametrize(("way", "every", "seed"), SOME)
def test_conversions_are_flagged_or_leave_no_trace(way, every, seed):
    result, words = outcome(ConvertedCase(way, every, seed))
    assert result != "silent", words


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_ordinary_records_have_no_flag(seed):
    series, _, _, hz = ConvertedCase("none", 2, seed).record()
    _, words = answer(series, hz)
    assert FLAG not in words


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_at_most_one_conversion_in_twenty_is_silent():
    """Two hundred records; none of fifty others is flagged, whose false alarms are one in a thousand."""
    counts = Counter((case.way, outcome(case)[0]) for case in cases(5))
    silent = sum(count for (_, result), count in counts.items() if result == "silent")
    assert silent <= 0.05 * 200, counts
    assert counts["none", "flagged"] == 0, counts


@pytest.mark.parametrize("seed", range(4))
def test_a_weak_mode_that_the_fit_lacks_is_no_side_band(seed):
    """Mode 2 at 1 % of mode 3, one line in the residual: blended frames would have two."""
    time_s = np.arange(396) / 200.0
    noise = 0.012 * np.random.default_rng(seed).standard_normal(time_s.size)
    wave = decay(time_s, 29.253, 0.0028, 1.2) + decay(time_s, 10.59, 0.002, 0.012, 1.0 + seed) + noise
    model = find_modes(prepare(series_of(time_s, wave)).data, max_modes=1)
    assert conversion(model, steady_noise=True, predicted=False) is None
