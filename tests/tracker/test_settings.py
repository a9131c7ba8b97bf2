"""Settings accept plain numbers, text and arrays, and name the error in other values."""

from fractions import Fraction

import numpy as np
import pytest
from pydantic import ValidationError

from modal_id import IdentifySettings, SamplerSettings
from tracker import TrackerSettings


@pytest.mark.parametrize(
    ("given", "fps"),
    [
        (500, 500),
        (500.0, 500),
        (59.94, Fraction(5994, 100)),
        ("30000/1001", Fraction(30000, 1001)),
        (Fraction(1, 3), Fraction(1, 3)),
        (np.float64(240.5), Fraction(481, 2)),
        (np.int64(1000), 1000),
    ],
)
def test_a_frame_rate_is_stored_as_an_exact_fraction(given, fps):
    stored = TrackerSettings(fps=given).fps
    assert stored == fps
    assert isinstance(stored, Fraction)


def test_lists_and_arrays_are_accepted():
    settings = TrackerSettings(
        positions_mm=np.array([1.0, 2.0]), points_px=[[1, 2], [3, 4]], mm_per_px=np.float32(0.5)
    )
    assert settings.positions_mm == (1.0, 2.0)
    assert settings.points_px == ((1.0, 2.0), (3.0, 4.0))
    assert settings.mm_per_px == 0.5
    theory = IdentifySettings(
        expected_frequencies_hz=np.array([2.0, 3.0]), expected_shapes=[[1, 2], [3, 4], [5, 6]]
    )
    assert theory.expected_frequencies_hz == (2.0, 3.0)
    assert theory.expected_shapes.shape == (3, 2)


@pytest.mark.parametrize(
    ("settings", "wrong", "words"),
    [
        (TrackerSettings, {"fsp": 500}, "unknown key 'fsp'; did you mean 'fps'?"),
        (
            TrackerSettings,
            {"size_mm": -1},
            "size_mm: input should be greater than or equal to 0.000001, found -1",
        ),
        (TrackerSettings, {"dictionary": "DICT_4X4_51"}, "such as DICT_4X4_50"),
        (TrackerSettings, {"positions_mm": [3, 3]}, "differ"),
        (IdentifySettings, {"mode": 0}, "mode: input should be greater than or equal to 1"),
        (IdentifySettings, {"expected_shapes": np.ones((3, 2))}, "one column for each of the 0"),
        (SamplerSettings, {"check_steps": 2000}, "1..max_steps"),
    ],
)
def test_errors_are_reported_in_one_line(settings, wrong, words):
    with pytest.raises(ValueError, match=r"found|did you mean") as info:
        settings(**wrong)
    assert words in str(info.value)
    assert "\n" not in str(info.value)


def test_settings_are_frozen_and_documented():
    settings = TrackerSettings()
    with pytest.raises(ValidationError, match="frozen"):
        settings.fps = 3
    assert "exposure_s : default None\n    Exposure time of a frame." in TrackerSettings.__doc__
