"""Displacement, scale and settings, against exact values."""

from dataclasses import replace

import numpy as np
import pytest
from kit.tracks import tracks_of

from tracker import Scale, TrackerSettings, displacement_series, flags, position_errors
from tracker.geometry import resolve_scale
from tracker.template import largest_sd, series_sd


def tracks(n=200, scale=None, reference=()):
    t = np.arange(n) / 100
    s = np.sin(7 * t)[:, None]
    base = 0.2 * np.cos(3 * t)[:, None]
    x = np.array([100.0, 110.0, 120.0]) + s * np.array([1.0, 2.0, 0.0]) + base
    # y points down in the image: this motion is to the right and up.
    y = np.array([50.0, 100.0, 150.0]) - 0.5 * s * np.array([1.0, 2.0, 0.0])
    return tracks_of(
        x, y, fps=100, positions_mm=np.array([10.0, 60.0, 110.0]), scale=scale, reference=reference
    )


def test_direction_is_right_and_up_and_the_reference_is_removed():
    series = displacement_series(tracks(reference=("m3",)))
    assert series.channels == ("m1", "m2")
    assert series.unit == "px"
    assert series.direction == pytest.approx(np.array([1.0, 0.5]) / np.sqrt(1.25), abs=1e-6)
    ratio = np.std(series.values[:, 1]) / np.std(series.values[:, 0])
    assert ratio == pytest.approx(2.0, abs=1e-6)
    # The reference has the same sd: variances add up.
    assert series.sd == pytest.approx(np.full((200, 2), 0.01 * np.sqrt(2)))
    assert series.positions_mm.tolist() == [10.0, 60.0]


def test_displacement_is_in_mm_if_a_scale_is_given():
    series = displacement_series(tracks(scale=Scale(0.25, 0.001, "as given")))
    plain = displacement_series(tracks())
    assert series.unit == "mm"
    assert series.values == pytest.approx(0.25 * plain.values)
    assert series.sd == pytest.approx(0.25 * plain.sd)
    with pytest.raises(ValueError, match="needs a scale"):
        displacement_series(tracks(), unit="mm")


def test_missing_and_repeated_frames_are_nan():
    before = tracks()
    x, frame_flags = before.x_px.copy(), before.flags.copy()
    x[5, 0] = np.nan
    frame_flags[7] = flags.DUPLICATE_FRAME.value
    series = displacement_series(replace(before, x_px=x, flags=frame_flags))
    assert np.isnan(series.values[5]).tolist() == [True, False, False]
    assert np.all(np.isnan(series.values[7]))
    assert np.count_nonzero(np.isnan(series.values)) == 4


def test_reference_markers_must_exist_and_leave_a_marker():
    with pytest.raises(ValueError, match="not among the markers"):
        displacement_series(tracks(reference=("m9",)))
    with pytest.raises(ValueError, match="every marker is a reference or an input"):
        displacement_series(tracks(reference=("m1", "m2", "m3")))


def test_scale_from_positions_and_its_disagreement():
    rest = np.array([[50.0, 0.0], [50.0, 200.0], [50.0, 400.0]])
    positions = np.array([0.0, 50.0, 100.0])
    found = resolve_scale(TrackerSettings(), [None] * len(rest), rest, positions)
    assert found.scale.mm_per_px == pytest.approx(0.25)
    assert found.notes == ()
    given = resolve_scale(TrackerSettings(mm_per_px=0.5), [None] * len(rest), rest, positions)
    assert given.scale.mm_per_px == 0.5
    assert "check sizes, positions and units" in given.notes[0]
    assert resolve_scale(TrackerSettings(), [None] * len(rest), rest, np.full(3, np.nan)).scale is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "square"},
        {"kind": "patch"},
        {"size_mm": 0.0},
        {"mm_per_px": -1.0},
        {"exposure_s": float("nan")},
        {"positions_mm": (1.0, 1.0)},
        {"points_px": ((1.0, float("inf")),)},
        {"clamp_side": "above"},
        {"names": ("tip", "tip")},
        {"names": ("=1+1",)},
        {"names": ("tip",), "kind": "line"},
    ],
)
def test_invalid_settings_are_rejected(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        TrackerSettings(**wrong)


def test_series_sd_estimates_white_errors_under_vibration():
    rng = np.random.default_rng(4)
    t = np.arange(2000.0)
    motion = np.sin(0.21 * t)[:, None] * [3.0, 2.0] + np.sin(0.9 * t)[:, None] * [0.3, -0.5]
    noisy = motion + rng.normal(0, 0.02, motion.shape)
    # The sd of a median of 2000 samples is 1.2 / sqrt(2000) = 2.6 %: four of these.
    assert series_sd(noisy, predictive=True) == pytest.approx(0.02, rel=0.11)


def test_position_errors_follow_the_marker_along_both_axes_of_the_image():
    """Positions computed from the displacement are those that were tracked, in px and in mm."""
    for scale, unit in ((None, "px"), (Scale(0.5, 0.0, "user"), "mm")):
        one = tracks(scale=scale)
        series = displacement_series(one, unit=unit)
        errors = series.position_errors
        for axis, positions in enumerate((one.x_px, one.y_px)):
            placed = errors.rest_px[axis] + errors.px_per_unit[axis] * series.values
            # What differs is the motion across the direction: 0.2 px of the base.
            assert np.nanmax(np.abs(placed - positions)) < 0.25
        # A share of the sd of 0.01 px of each marker, split between the axes by the direction.
        size = np.sqrt(np.sum(errors.periodic_sd**2, axis=0))
        assert size == pytest.approx(
            position_errors.TUNING.lossless_share * 0.01 * (1.0 if unit == "px" else 0.5), rel=1e-6
        )


def test_errors_of_predicted_frames_are_those_of_the_moving_part():
    """Errors of 0.04 px in the first quarter of the frames and of 0.01 px at rest, correlated over some frames.

    The bulk of 1500 residuals determines an sd to about 3 %, correlation widens that.
    """
    rng, n = np.random.default_rng(3), 6000
    noise = rng.standard_normal((n, 1)) * np.where(np.arange(n) < n // 4, 0.04, 0.01)[:, None]
    assert largest_sd(noise) == pytest.approx([0.04], rel=0.1)
    assert series_sd(noise, predictive=True) < 0.03


def test_position_errors_depend_on_the_codec():
    lossless = tracks()
    for predictive in (False, True):
        decode = replace(lossless.decode, lossy=True, predictive=predictive)
        errors = displacement_series(replace(lossless, decode=decode), unit="px").position_errors
        assert (errors.periodic_sd.size == 0) == predictive
        # The sd of each position is 0.01 px.
        assert errors.shrinkage_sd == pytest.approx(
            0.01
            * (position_errors.TUNING.shrinkage_sd if predictive else position_errors.TUNING.lossy_shrinkage)
        )
        assert errors.shrinkage == pytest.approx(
            0.01 * position_errors.TUNING.forward_shrinkage if predictive else 0.0
        )
        assert errors.lag == pytest.approx(0.01 * position_errors.TUNING.forward_lag if predictive else 0.0)
        # 1000 px from frame to frame: encoders that predict follow, the others change frames whatever the motion.
        assert errors.omitted(0, np.array([1e3])) == pytest.approx(0.0 if predictive else 1.0, abs=1e-9)
        assert errors.period_px == 8.0
    # Frames predicted from later ones, too, do not lag on average.
    decode = replace(lossless.decode, lossy=True, predictive=True, reordered=True)
    errors = displacement_series(replace(lossless, decode=decode), unit="px").position_errors
    assert errors.shrinkage == pytest.approx(0.01 * position_errors.TUNING.shrinkage)
    assert errors.lag == pytest.approx(0.0)


def test_an_input_marker_gives_the_motion_of_the_base():
    """The base moves all markers; the input is its motion along the vibration, and is not subtracted."""
    series = displacement_series(replace(tracks(), input=("m3",)), direction=(1.0, 0.0))
    assert series.channels == ("m1", "m2")
    assert series.base is None
    known, t = series.known_input, np.arange(200) / 100
    expected = 0.2 * np.cos(3 * t)
    np.testing.assert_allclose(known.values, expected - np.median(expected), atol=1e-9)
    assert known.sd == pytest.approx(0.01)
    assert known.unit == series.unit
    both = np.sin(7 * t) + expected
    np.testing.assert_allclose(series.values[:, 0], both - np.median(both), atol=1e-9)


def test_a_reference_is_subtracted_from_an_input_as_well():
    series = displacement_series(replace(tracks(reference=("m3",)), input=("m1",)), direction=(1.0, 0.0))
    assert series.channels == ("m2",)
    np.testing.assert_allclose(series.known_input.values, 0.5 * series.values[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("names", "reference", "words"),
    [
        (("m9",), (), "input m9 is not among"),
        (("m3",), ("m3",), "m3 is a reference"),
        (("m1", "m2", "m3"), (), "input"),
    ],
)
def test_inputs_that_cannot_be_used_are_refused(names, reference, words):
    with pytest.raises(ValueError, match=words):
        displacement_series(replace(tracks(reference=reference), input=names))
