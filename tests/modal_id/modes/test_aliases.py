"""Aliases: the arithmetic of sampling, odds of simulated structures, uneven times, and real forks at three rates."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit import films
from kit.identified import quick
from kit.series import pole_of, series_of
from support.paths import REALDATA, REALDATA_ABSENT

from modal_id.modes import Line, alias_frequencies, apparent_hz, lines_of, resolve_aliases
from tracker import TrackerSettings, displacement_series, track


@given(st.floats(0.1, 5000.0), st.floats(10.0, 1000.0))
def test_all_aliases_and_no_others_have_the_same_samples(frequency_hz, rate_hz):
    """Samples of a cosine, which does not know the sign of a frequency, at each alias and at one that is none."""
    found = alias_frequencies(apparent_hz(frequency_hz, rate_hz), rate_hz, frequency_hz + rate_hz)
    assert 0.0 <= found[0] <= 0.5 * rate_hz
    assert np.min(np.abs(found - frequency_hz)) < 1e-9 * (frequency_hz + rate_hz), "it is its own alias"
    phase = 2.0 * np.pi * np.arange(20) / rate_hz
    samples = np.cos(phase * frequency_hz)
    # Phases up to 20 cycles per frequency over rate: each is rounded to 2^-53 of it.
    tolerance = 20 * 2 * np.pi * (found[-1] / rate_hz + 1.0) * 2.0**-48
    for hz in found:
        np.testing.assert_allclose(np.cos(phase * hz), samples, atol=tolerance, err_msg=f"{hz} Hz")
    between = found[0] + 0.31 * rate_hz if found[0] < 0.19 * rate_hz else found[0] - 0.17 * rate_hz
    assert np.max(np.abs(np.cos(phase * between) - samples)) > 0.1


def test_a_line_with_the_number_of_another_mode_is_no_alias():
    """The samples' beam: mode 2 appears where mode 5, at 88.6 Hz, would if it were at 511.4 Hz."""
    mode5, mode2 = Line("take5", 600.0, 88.59, 0.02, number=5), Line("take3", 250.0, 11.41, 0.02, number=2)
    assert mode2.frequency_hz == pytest.approx(apparent_hz(511.41, 250.0), abs=0.01)
    assert resolve_aliases([mode5, replace(mode2, number=None)]).lines[0].applies
    assert not resolve_aliases([mode5, mode2]).lines[0].applies


def structure(rng, rates_hz=(250.0, 410.0, 530.0), sd_hz=0.02, ppm=50.0):
    """Frequency and lines of one mode, as the model has them, and how many of the recordings show it.

    The first one does, the others with a probability of 0.5, beside up to two lines of other modes. The frequency is
    below twice the lowest rate.
    """
    true_hz = rng.uniform(5.0, 2.0 * min(rates_hz))
    shown = [True, *(rng.random(2) < 0.5)]
    lines = []
    for k, rate in enumerate(rates_hz):
        true = [true_hz * (1.0 + 1e-3 * rng.standard_t(4.0) * (k > 0))] if shown[k] else []
        other = rng.uniform(1.0, 0.5 * rate, rng.integers(0, 3)).tolist() if k else []
        rate_error = 1.0 + 1e-6 * ppm * rng.standard_normal()
        for hz in true + other:
            seen = max(apparent_hz(hz, rate * rate_error) / rate_error + sd_hz * rng.standard_normal(), 0.01)
            lines.append(Line(f"take{k}", rate, seen, sd_hz, rate_sd_ppm=ppm, doubtful=True))
    return true_hz, lines, sum(shown)


def test_odds_are_those_of_simulated_structures():
    """Of lines whose most probable frequency has the probability p, a share of p or more is right."""
    right, probability, decided, shown = [], [], [], []
    for seed in range(400):
        true_hz, lines, count = structure(np.random.default_rng([seed, 36]))
        found = resolve_aliases(lines).lines[0]
        # Eight standard deviations of the line, six of the rate.
        right.append(abs(found.best.frequency_hz - true_hz) < 8.0 * 0.02 + 3e-4 * true_hz)
        probability.append(found.best.probability)
        decided.append(found.decided)
        shown.append(count)
    right, probability, decided, shown = map(np.array, (right, probability, decided, shown))
    for chosen, name in ((decided, "decided"), (probability > 0.99, "above 0.99"), (~decided, "undecided")):
        p = probability[chosen]
        least = np.sum(p) - 3.1 * np.sqrt(np.sum(p * (1.0 - p)))  # chance falls below it once in 1000
        count = np.sum(right[chosen])
        assert count >= least, f"{name}: {count} of {p.size} right, expected {least:.1f}"
    # A coincidence of one of eight frequencies within 1 Hz in both others is rare: 8 (2 / 205) (2 / 265) = 6e-4.
    assert np.mean(decided[shown == 3]) > 0.95, "three recordings that show the mode must decide"


def test_one_rate_lists_all_aliases_as_equally_probable():
    line = Line("fork", 250.0, 122.07, 0.01, doubtful=True)
    copy = replace(line, recording="again", rate_hz=250.1)
    for found in (*resolve_aliases([line]).lines, *resolve_aliases([line, copy]).lines):
        assert not found.decided
        assert [round(one.frequency_hz, 1) for one in found.aliases] == [122.1, 127.9, 372.1, 377.9] or copy
        assert {alias.probability for alias in found.aliases} == {0.25}
        assert "Record the structure again at another rate" in str(found)
    assert not resolve_aliases([replace(line, doubtful=False)]).lines[0].applies
    assert resolve_aliases([line, copy]).plot().get_legend() is not None
    assert len(resolve_aliases([line, copy]).to_dataframe()) == 8


def test_an_image_of_a_line_is_no_evidence():
    """Errors that alternate from frame to frame mirror 127.93 Hz at 500 Hz to 122.07 Hz, the alias at 250 Hz."""
    line = Line("slow", 250.0, 122.07, 0.01, doubtful=True)
    mode = Line("fast", 500.0, 127.95, 0.01, amplitude=1.0)
    image = Line("fast", 500.0, 122.05, 0.01, amplitude=0.2)
    decided = resolve_aliases([line, mode, image]).lines[0]
    assert decided.best.frequency_hz == pytest.approx(127.93, abs=1e-9)
    assert decided.odds == pytest.approx(resolve_aliases([line, mode]).lines[0].odds)
    equal = resolve_aliases([line, mode, replace(image, amplitude=1.0)]).lines[0]
    assert not equal.decided, "two lines of equal amplitude: neither is an image of the other"


def test_the_decay_rate_stays_and_the_damped_frequency_folds():
    line = Line("a", 100.0, 30.0, 0.01, damping_ratio=0.2, doubtful=True)
    found = resolve_aliases([line]).lines[0].aliases[1]
    damped_hz, rate = 30.0 * np.sqrt(0.96), 0.2 * 30.0
    assert found.frequency_hz**2 == pytest.approx((100.0 - damped_hz) ** 2 + rate**2)
    assert found.damping_ratio * found.frequency_hz == pytest.approx(rate)


@pytest.mark.parametrize("change", [{"rate_hz": 0.0}, {"frequency_hz": np.nan}, {"frequency_sd_hz": -1.0}])
def test_a_line_that_cannot_be_is_refused(change):
    (name,) = change
    with pytest.raises(ValueError, match=f"take: {name} must be finite"):
        replace(Line("take", 100.0, 30.0, 0.01), **change)


def test_few_frequencies_are_considered_for_very_different_rates():
    """Up to 50 times the rate of the line: two a period."""
    slow, fast = Line("slow", 1.0, 0.3, 1e-4, doubtful=True), Line("fast", 1e6, 12.3, 1e-4)
    assert len(resolve_aliases([slow, fast]).lines[0].aliases) <= 101


@pytest.mark.parametrize(
    ("true_hz", "jitter", "stated"), [(90.0, 0.1, True), (10.0, 0.1, True), (90.0, 0.1, False)]
)
def test_uneven_times_tell_aliases_apart(true_hz, jitter, stated):
    """Times off an even grid by 10 % of a step: 90 Hz at 100 Hz. Where only the stated times are uneven, none does."""
    rng = np.random.default_rng(36)
    grid = np.arange(600) / 100.0
    uneven = grid + jitter / 100.0 * rng.uniform(-1.0, 1.0, grid.size)
    y = np.exp(pole_of(true_hz, 0.1 / true_hz) * (uneven if stated else grid)).real
    series = series_of(uneven, y + 0.02 * rng.standard_normal(grid.size))
    (line,) = lines_of("take", quick(series, onset_s=0.0))
    (found,) = resolve_aliases([line]).lines
    assert found.decided == stated, found
    assert found.best.frequency_hz == pytest.approx(true_hz if stated else 10.0, abs=0.1)


FORKS = {
    250: (REALDATA / "tuning_forks" / "tuning_hz128_fps250_50-1_640x420.mp4", (364.0, 103.0)),
    1000: (REALDATA / "ordinary" / "fork128_on_bricks_fps1000.mp4", (472.0, 112.0)),
}


@pytest.mark.skipif(not REALDATA.is_dir(), reason=REALDATA_ABSENT)
@pytest.mark.parametrize("frames", [250, pytest.param(4000, marks=pytest.mark.slow)])
def test_forks_at_three_rates_are_at_127_9_hz(frames, tmp_path):
    """Two films of one fork, the faster one also with each second frame: 127.9 Hz by least squares at 1000 fps."""
    found = {}
    for fps, (path, point) in FORKS.items():
        film = films.first_frames(path, tmp_path / f"{fps}.mp4", frames)
        settings = TrackerSettings(fps=Fraction(fps), kind="patch", points_px=(point,), size_px=41.0)
        series = displacement_series(track(film, settings, recording=str(fps)))
        half = series_of(series.time_s[::2], series.values[::2], series.unit)
        for rate, one in ((fps, series), (fps // 2, half)):
            if rate >= 250:
                found[rate] = lines_of(str(rate), quick(one))
    alone = resolve_aliases(found[250]).lines[0]
    assert not alone.informed
    assert alone.applies, "a frequency near half the rate is doubtful"
    for rates in ((250, 500), (250, 1000), (250, 500, 1000)):
        fork = resolve_aliases(line for rate in rates for line in found[rate]).lines[0]
        assert fork.best.frequency_hz == pytest.approx(127.9, abs=0.1)
        assert fork.best.probability > 0.99, f"{rates}: {fork}"
