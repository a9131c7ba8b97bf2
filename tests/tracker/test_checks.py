"""Failures as values, and checks of numbers that a caller gives."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker import Failure, checked


def test_a_failure_is_falsy_and_says_where_why_and_what_next():
    failure = Failure("no marker moves", "a.avi", "film the vibration")
    assert not failure
    assert str(failure) == "a.avi: no marker moves; film the vibration"
    assert str(Failure("no marker moves")) == "no marker moves"


@given(st.floats(), st.booleans(), st.floats(-10.0, 0.0), st.floats(1.0, 10.0))
def test_what_is_returned_is_finite_and_within_its_limits(value, positive, least, most):
    fine = math.isfinite(value) and least <= value <= most and (value > 0.0 or not positive)
    if fine:
        assert checked("gap_mm", value, positive=positive, at_least=least, at_most=most) == value
    else:
        with pytest.raises(ValueError, match=r"^gap_mm must be finite .*, got "):
            checked("gap_mm", value, positive=positive, at_least=least, at_most=most)


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"positive": True}, "E must be finite and positive, got nan"),
        ({"at_least": 0.0}, "E must be finite and not negative, got nan"),
        ({"at_least": 2.0, "at_most": 3.0}, "E must be finite and at least 2 and at most 3, got nan"),
    ],
)
def test_the_message_names_the_value_and_its_limits(limits, text):
    with pytest.raises(ValueError, match=text):
        checked("E", math.nan, **limits)
