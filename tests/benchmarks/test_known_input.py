"""Modes from the response to a measured input, against the truth of simulations."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import in_sd
from kit.series import series_of
from kit.tracks import tracks_of

from benchmarks.known_input_scenes import (
    DAMPING_RATIOS,
    FORCE_NOISE_N,
    FORCE_RATE_HZ,
    FREQUENCIES_HZ,
    NOISE_MM,
    PARTICIPATION,
    RATE_HZ,
    Record,
    force_record,
    late_base,
    motion,
    record,
)
from modal_id import Identification, IdentifiedMode, IdentifySettings, identify
from modal_id.response import at_other_times
from tracker import DisplacementSeries, Failure, KnownInput, displacement_series

#: Four values, each within this many sd: one in 4000 seeds fails by chance.
_LIMIT = 4.0


def _series(one: Record, input_sd: float = float("nan")) -> DisplacementSeries:
    known = KnownInput("base", one.base, "mm", sd=input_sd)
    return series_of(one.time_s, one.values, "mm", channels=("y1", "y2", "y3"), known_input=known)


def _found(series: DisplacementSeries) -> Identification:
    found = identify(series)
    assert isinstance(found, Identification), str(found)
    return found


def _check(found: Identification, which: slice = slice(None)) -> None:
    hz, zeta = FREQUENCIES_HZ[which], DAMPING_RATIOS[which]
    assert not any(mode.flags for mode in found.modes), f"the model is that of the simulation: {found!r}"
    assert len(found.modes) == hz.size, f"{hz.size} modes were simulated, found {found!r}"
    for mode, f, z in zip(found.modes, hz, zeta, strict=True):
        _check_mode(mode, f, z)


def _check_mode(mode: IdentifiedMode, hz: float, zeta: float) -> None:
    scores = in_sd(mode, hz, zeta)
    assert np.max(np.abs(scores)) < _LIMIT, f"{mode!r}: {scores} sd from {hz} Hz and {zeta}"


@pytest.mark.parametrize(
    ("kind", "correlation"),
    [
        ("sweep", 0.8),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("sweep", 0.0), ("random", 0.8))),
    ],
)
def test_the_truth_lies_in_the_interval(kind: str, correlation: float) -> None:
    found = _found(_series(record(kind, 1, correlation=correlation), input_sd=0.0))
    _check(found)
    for mode, truth in zip(found.modes, PARTICIPATION, strict=True):
        assert mode.participation is not None
        assert mode.participation_sd is not None
        scores = (mode.participation - truth) / np.hypot(mode.participation_sd, 2e-3)
        assert np.max(np.abs(scores)) < _LIMIT, f"participation {mode.participation}, simulated {truth}"


def test_shaking_by_hand_shows_the_mode_that_it_drives() -> None:
    _check(_found(_series(record("hand", 2), input_sd=0.0)), slice(0, 1))


# In the sweep of seed 29 the first pole that is found lies between both modes; the lines of the broad record are
# further apart than the width of a resonance.
@pytest.mark.parametrize(
    ("kind", "seed"),
    [("random", 3), *(pytest.param(*one, marks=pytest.mark.slow) for one in (("sweep", 29), ("broad", 12)))],
)
def test_noise_of_the_input_does_not_bias_damping(kind: str, seed: int) -> None:
    _check(_found(_series(record(kind, seed, input_noise_mm=0.02), input_sd=0.02)))


# The input of broad record 26 does not vanish at its ends; at a wrong lag, that of hand 28 shows a second mode; rows
# without an input showed strongly damped ones in broad 1001 and 1009.
@pytest.mark.parametrize(
    ("kind", "seed", "lag"),
    [
        ("broad", 1009, -4.552),
        ("hand", 2, -6.48),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (
                ("random", 1, 2.64),
                ("broad", 26, 0.564),
                ("hand", 28, 8.032),
                ("broad", 1001, 4.978),
            )
        ),
    ],
)
def test_the_lag_of_the_input_is_estimated(kind: str, seed: int, lag: float) -> None:
    """The base motion is that of another time, by its closed form; lag in samples."""
    lag_s = lag / RATE_HZ
    series = _series(replace(record(kind, seed), base=late_base(kind, seed, lag_s)), input_sd=0.0)
    found = identify(series, IdentifySettings(input_lag_ms="auto"))
    assert isinstance(found, Identification), str(found)
    _check(found, slice(0, 1 if kind == "hand" else 2))
    assert found.response is not None
    off_s, sd_s = found.response.input_lag_s - lag_s, found.response.input_lag_sd_s
    assert abs(off_s) < _LIMIT * sd_s, f"lag off by {off_s:.2g} s, sd {sd_s:.2g} s"
    # Noise of 1/30 of the base motion at some Hz, averaged over thousands of samples, moves it by parts of a sample.
    assert sd_s < 0.1 / RATE_HZ
    stated = identify(series, IdentifySettings(input_lag_ms=1e3 * lag_s))
    assert isinstance(stated, Identification), str(stated)
    _check(stated, slice(0, len(found.modes)))


@pytest.mark.parametrize("lag_s", [0.0, 0.0066])
def test_an_input_that_is_late_without_a_word_is_flagged(lag_s: float) -> None:
    """Values are then off by up to 8 sd; at the true lag another one is never e^10 times as likely, but in 1 of 1e5."""
    series = _series(replace(record("random", 1), base=late_base("random", 1, lag_s)), input_sd=0.0)
    flags = {flag for mode in _found(series).modes for flag in mode.wrong_flags}
    assert ("INPUT_LATE" in flags) == (lag_s > 0.0), f"the input is late by {lag_s} s: {flags}"


@pytest.mark.parametrize("seed", [4, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 1, 2, 3, 5, 6))])
def test_modes_of_an_input_folded_at_half_the_rate_are_right_and_flagged_or_refused(seed: int) -> None:
    """Every second sample, without a filter, of motions up to 195 Hz: they were once off by up to 120 sd."""
    one = record("broad", seed)
    found = identify(_series(Record(one.time_s[::2], one.base[::2], one.values[::2]), input_sd=0.0))
    assert isinstance(found, Identification), str(found)
    for mode in found.modes:
        assert "INPUT_INCOMPLETE" in mode.flags
        nearest = int(np.argmin(np.abs(FREQUENCIES_HZ - mode.frequency_hz)))
        _check_mode(mode, FREQUENCIES_HZ[nearest], DAMPING_RATIOS[nearest])
    refused = [one.reason for one in found.failed]
    assert len(found.modes) + len(refused) >= 2
    assert all("filter the input" in reason for reason in refused)


@pytest.mark.slow
def test_the_lag_of_a_force_is_as_uncertain_as_its_likelihood_is_flat() -> None:
    """Three widths of the parabola at the maximum from the truth, 1.8 ms, which explains the outputs as well."""
    force = force_record("impacts", 0, -0.0119)
    values = at_other_times(force.force_time_s, force.force, force.time_s)
    assert isinstance(values, np.ndarray), values
    known = KnownInput(
        "force", values, "N", is_force=True, sd=FORCE_NOISE_N * np.sqrt(RATE_HZ / FORCE_RATE_HZ)
    )
    one = Record(force.time_s, np.zeros(force.time_s.size), force.values)
    found = identify(replace(_series(one), known_input=known), IdentifySettings(input_lag_ms="auto"))
    assert isinstance(found, Identification), str(found)
    _check(found)
    assert found.response is not None
    off_s, sd_s = found.response.input_lag_s + 0.0119, found.response.input_lag_sd_s
    assert abs(off_s) < 2.0 * sd_s, f"lag off by {off_s:.2g} s, sd {sd_s:.2g} s"


def test_a_lag_without_an_input_is_refused() -> None:
    series = replace(_series(record("decay", 5)), known_input=None)
    found = identify(series, IdentifySettings(input_lag_ms="auto"))
    assert isinstance(found, Failure)
    assert "no input was measured" in found.reason


def test_a_lag_beyond_the_record_is_refused() -> None:
    found = identify(_series(record("random", 7)), IdentifySettings(input_lag_ms=15e3))
    assert isinstance(found, Failure)
    assert "leaves less than 50 %" in found.reason


@pytest.mark.slow
def test_no_mode_of_the_input_of_another_record_is_without_a_flag() -> None:
    series = _series(replace(record("random", 1), base=record("random", 2).base))
    found = identify(series, IdentifySettings(input_lag_ms="auto"))
    modes = found.modes if isinstance(found, Identification) else ()
    assert all(mode.flags for mode in modes), f"the input is unrelated, found {found!r}"


@pytest.mark.parametrize("noise_mm", [pytest.param(0.0, marks=pytest.mark.slow), 0.02])
def test_noise_of_the_input_is_estimated_where_its_spectrum_has_a_floor(noise_mm: float) -> None:
    one = record("hand", 2, input_noise_mm=noise_mm)
    stated, unstated = _found(_series(one, input_sd=noise_mm)), _found(_series(one))
    _check(unstated, slice(0, 1))
    ratio = unstated.modes[0].damping_ratio_sd / stated.modes[0].damping_ratio_sd
    # The floor is the mean of some thousand bins of noise: its sd is 3 %.
    assert ratio == pytest.approx(1.0, abs=0.1), "from the standard deviation of the estimated noise"


def test_unknown_noise_of_an_input_without_a_floor_is_said() -> None:
    found = _found(_series(record("broad", 2, input_noise_mm=0.02)))
    _check(found)
    assert any("noise of the input base is unknown" in note for note in found.notes)


def _with_modes(hz: tuple[float, float]) -> DisplacementSeries:
    base, modes = motion("random", np.random.default_rng(3), (*hz, 0.009, 0.009))
    series = _series(record("random", 3), input_sd=0.0)
    noise = NOISE_MM * np.random.default_rng(4).standard_normal(series.values.shape)
    values = base[:, None] + modes @ PARTICIPATION + noise
    known = KnownInput("base", base, "mm", sd=0.0)
    return replace(series, values=values, known_input=known)


def test_a_mode_that_may_not_be_fitted_is_named() -> None:
    found = identify(_with_modes((6.4, 38.7)), IdentifySettings(max_modes=1))
    assert isinstance(found, Identification)
    (mode,) = found.modes
    assert any("leaves near 6.4" in note for note in mode.notes)


def test_a_mode_beside_one_that_may_not_be_fitted_is_flagged_and_its_interval_wider() -> None:
    one = identify(_with_modes((6.4, 15.0)), IdentifySettings(max_modes=1))
    assert isinstance(one, Identification)
    (mode,) = one.modes
    assert mode.flags == ("INPUT_INCOMPLETE", "RESIDUAL_AT_MODE")
    # As if all that is left were a response.
    assert mode.posterior.noise_factor > 2.0
    assert abs(mode.damping_ratio - 0.009) < _LIMIT * mode.damping_ratio_sd


def test_a_mode_close_to_one_that_may_not_be_fitted_is_refused() -> None:
    """With a damping ratio of .0125 for .009."""
    one = identify(_with_modes((6.4, 10.0)), IdentifySettings(max_modes=1))
    assert isinstance(one, Identification)
    assert not one.modes
    assert "What the fit leaves near 6.4" in one.failed[0].reason


def test_there_is_no_chain_and_no_diagnostics_of_one() -> None:
    posterior = _found(_series(record("hand", 2), input_sd=0.0)).modes[0].posterior
    assert np.isnan([*posterior.r_hat, *posterior.ess, posterior.acceptance]).all()
    # Quantiles of a permuted normal sample of 4000.
    assert np.std(posterior.frequency_hz) == pytest.approx(posterior.laplace_sd[0], rel=0.01)


def test_uneven_times_and_missing_samples() -> None:
    one = record("random", 4)
    kept = np.ones(one.time_s.size, dtype=bool)
    kept[np.random.default_rng(0).choice(kept.size, 80, replace=False)] = False
    values = one.values[kept].copy()
    values[1000:1040, 0] = np.nan
    _check(_found(_series(Record(one.time_s[kept], one.base[kept], values), input_sd=0.0)))


def test_a_decay_and_a_sweep_agree() -> None:
    decay = replace(_series(record("decay", 5)), known_input=None)
    free, driven = _found(decay), _found(_series(record("sweep", 5), input_sd=0.0))
    for one, other in zip(free.modes, driven.modes, strict=True):
        for value in ("frequency_hz", "damping_ratio"):
            sd_name = value.replace("_hz", "") + ("_sd_hz" if value.endswith("hz") else "_sd")
            apart = (getattr(one, value) - getattr(other, value)) / np.hypot(
                getattr(one, sd_name), getattr(other, sd_name)
            )
            assert abs(apart) < _LIMIT, f"{value}: {one!r} and {other!r} are {apart:.1f} sd apart"


def test_the_response_has_bands_that_contain_the_truth() -> None:
    response = _found(_series(record("random", 6), input_sd=0.0)).response
    assert response is not None
    s, omega = 2j * np.pi * response.frequency_hz[:, None], 2.0 * np.pi * FREQUENCIES_HZ
    truth = 1.0 + (-(s**2) / (s**2 + 2.0 * DAMPING_RATIOS * omega * s + omega**2)) @ PARTICIPATION
    driven = (response.frequency_hz > 3.0) & (response.frequency_hz < 55.0)
    near = np.min(np.abs(response.frequency_hz[:, None] - FREQUENCIES_HZ) / FREQUENCIES_HZ, axis=1) < 0.02
    inside = (np.abs(truth) > response.magnitude_q05) & (np.abs(truth) < response.magnitude_q95)
    # Neighbouring frequencies share their errors: about four independent values a channel and mode, 24 in all. With
    # 90 % expected, fewer than 60 % have a probability below 0.001.
    assert np.mean(inside[near & driven]) > 0.6
    scores = np.abs(response.local - truth)[driven & ~near] / response.local_sd[driven & ~near]
    # Modulus of a complex normal error, its sd that of one part: median sqrt(2 ln 2) = 1.18; t with 14 degrees.
    assert 0.8 < float(np.nanmedian(scores)) < 1.8, "from the modulus of a complex normal error"
    assert float(np.median(response.coherence[driven & ~near])) > 0.9


def _altered(change: str) -> DisplacementSeries:
    series = _series(record("random", 7))
    assert series.known_input is not None
    values = series.known_input.values.copy()
    if change == "still":
        values[:] = 1.0
    elif change == "clipped":
        values = np.clip(values, -0.1, 0.1)
    elif change == "lower rate":
        values = np.repeat(values[::4], 4)
    elif change == "outputs at a lower rate":
        outputs = series.values.copy()
        outputs[np.arange(len(outputs)) % 4 > 0] = np.nan
        return replace(series, values=outputs)
    elif change == "shorter":
        values[4000:] = np.nan
    else:
        values[1000:3000] = np.nan
    return replace(series, known_input=replace(series.known_input, values=values))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("still", "does not move"),
        ("clipped", "is clipped"),
        ("gap", "is missing in 25 %"),
        ("shorter", "is missing in 50 %"),
        ("lower rate", "keeps each value for 4 samples"),
        ("outputs at a lower rate", "have a value in 25 % of the rows"),
    ],
)
def test_an_input_that_cannot_be_used_is_refused_with_the_reason(change: str, words: str) -> None:
    found = identify(_altered(change))
    assert isinstance(found, Failure)
    assert words in found.reason


def test_an_input_is_not_fitted_beyond_the_outputs() -> None:
    series = _series(record("random", 7), input_sd=0.0)
    series.values[6000:] = np.nan
    found = _found(series)
    _check(found)
    assert any("from 0 to 15 s" in note for note in found.notes)


def test_the_longest_part_without_a_gap_of_the_input_is_fitted() -> None:
    """A second of the input, its first 10 ms and two samples are missing; the beam moves when the part begins."""
    series = _series(record("random", 7), input_sd=0.0)
    assert series.known_input is not None
    series.known_input.values[np.r_[:4, 2000:2400, 5000:5002]] = np.nan
    found = _found(series)
    _check(found)
    assert any("from 6 to 20 s, the longest part without a gap" in note for note in found.notes), found.notes


def test_an_input_of_another_clock_is_said() -> None:
    """Late by 2 ms more at the end than at the start: a hundredth of a period of the lower mode a second."""
    one = record("random", 7)
    late = np.interp(1.0001 * one.time_s, one.time_s, one.base)
    found = _found(_series(replace(one, base=late)))
    assert all("INPUT_INCOMPLETE" in mode.flags for mode in found.modes)
    assert any("to one clock" in note for note in found.modes[0].notes)


def test_an_input_of_another_length_is_refused() -> None:
    series = _series(record("random", 8))
    with pytest.raises(ValueError, match="same clock and length"):
        replace(series, known_input=KnownInput("base", np.zeros(5), "mm"))


def test_a_marker_on_the_clamp_gives_the_motion_of_the_base() -> None:
    one = record("random", 12, input_noise_mm=NOISE_MM)
    x_px = np.column_stack([one.base, one.values]) + np.array([100.0, 150.0, 200.0, 250.0])
    tracks = tracks_of(x_px, fps=400, sd_px=NOISE_MM, input=("m1",))
    series = displacement_series(tracks)
    assert series.channels == ("m2", "m3", "m4")
    found = _found(series)
    _check(found)
    mode = found.modes[0]
    assert mode.participation is not None
    assert mode.participation_sd is not None
    scores = (mode.participation - PARTICIPATION[0]) / mode.participation_sd
    assert np.max(np.abs(scores)) < _LIMIT, f"found {mode.participation}, simulated {PARTICIPATION[0]}"


def test_an_unrelated_input_shows_no_mode() -> None:
    series = _series(record("random", 9))
    noise = np.random.default_rng(9).standard_normal(series.values.shape)
    found = identify(replace(series, values=noise))
    assert isinstance(found, Failure), f"expected no mode in noise, found {found!r}"
    assert "no mode exceeds the noise" in found.reason


def test_the_input_is_ignored_on_request() -> None:
    series = _series(record("decay", 10), input_sd=0.0)
    found = identify(series, IdentifySettings(output_only=True))
    plain = identify(replace(series, known_input=None))
    assert repr(found) == repr(plain)


def test_a_measured_input_and_ambient_excitation_are_refused_together() -> None:
    found = identify(_series(record("random", 10)), IdentifySettings(excitation="ambient"))
    assert isinstance(found, Failure)
    assert "give one of the two" in found.reason
