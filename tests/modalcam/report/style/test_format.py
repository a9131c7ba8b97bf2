import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modalcam.report.style import (
    count,
    decimals_of,
    fixed,
    hertz,
    in_unit,
    interval,
    listed,
    odds,
    p_value,
    percent,
    rate,
    signed,
    significant,
    thousands,
    with_sd,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
ordinary = st.floats(min_value=-1e5, max_value=1e5)
ordinary_sd = st.floats(min_value=1e-7, max_value=1e4)


def number(text):
    return float(text.replace("−", "-"))


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (10.190123, 0.0012, "10.1901 ± 0.0012"),
        (10.190123, 0.00996, "10.190 ± 0.010"),
        (10.190123, 0.00994, "10.1901 ± 0.0099"),
        (1234.5, 120.0, "1230 ± 120"),
        (-0.00001, 0.01, "0.000 ± 0.010"),
        (-2.5, 0.5, "−2.50 ± 0.50"),
        (3.14159, float("nan"), "3.142"),
        (3.14159, 0.0, "3.142"),
        (float("nan"), 0.1, "–"),
        (1.5e-12, 2.5e-13, "(1.50 ± 0.25) × 10⁻¹²"),
        (4.2e9, 1.3e8, "(4.20 ± 0.13) × 10⁹"),
    ],
)
def test_value_with_its_sd(value, sd, text):
    assert with_sd(value, sd) == text


@given(value=ordinary, sd=ordinary_sd)
def test_value_and_sd_are_rounded_by_less_than_a_twentieth_of_the_sd(value, sd):
    text = with_sd(value, sd)
    shown, shown_sd = (number(part) for part in text.split(" ± "))
    # The sd has two digits: the last digit is at most a tenth of it, the rounding error half of that.
    slack = 0.05 * sd * (1.0 + 1e-6) + 1e-9 * abs(value)
    assert abs(shown - value) <= slack, text
    assert abs(shown_sd - sd) <= slack, text


@given(value=ordinary, sd=ordinary_sd)
def test_value_and_sd_have_the_same_decimals(value, sd):
    left, right = with_sd(value, sd).split(" ± ")
    assert len(left.partition(".")[2]) == len(right.partition(".")[2])


@given(value=finite, sd=finite)
def test_all_doubles_can_be_formatted(value, sd):
    for text in (with_sd(value, sd), interval(value, value, sd), significant(value), percent(value)):
        assert text
        assert "e" not in text, text
        assert "-" not in text, "a hyphen is not a minus sign"
        assert not text.startswith("−0 ")


@given(sd=st.floats(min_value=1e-300, max_value=1e300))
def test_decimals_show_two_digits(sd):
    scaled = f"{sd:.1e}"
    assert decimals_of(sd) == 1 - int(scaled.partition("e")[2])


@pytest.mark.parametrize("sd", [0.0, -1.0, math.nan, math.inf])
def test_decimals_need_a_positive_sd(sd):
    with pytest.raises(ValueError, match="finite and positive"):
        decimals_of(sd)


def test_special_values_and_thousands():
    assert interval(1.0, 2.0, 0.25) == "1.00 … 2.00"
    assert interval(math.nan, 2.0, 0.25) == "–"
    assert fixed(math.inf, 2) == "∞"
    assert significant(0.0) == "0"
    assert significant(123456.0) == "123456"
    assert significant(3.18e-5) == "3.18 × 10⁻⁵"
    assert percent(0.0512) == "5.1 %"
    assert count(1, "marker") == "1 marker"
    assert count(2, "marker") == "2 markers"
    assert thousands(9999) == "9999"
    assert thousands(1234567) == "1\u202f234\u202f567"


def test_a_dimensionless_number_has_no_unit():
    assert in_unit("0.933 ± 0.012", "1") == "0.933 ± 0.012"
    assert in_unit("0.933", "mm") == "0.933 mm"


def test_signs_odds_rates_and_lists():
    assert [signed(v, 2) for v in (0.5, -0.5, 0.001, math.nan)] == ["+0.50", "−0.50", "0.00", "–"]
    assert odds(math.log(12.0)) == "12 : 1"
    assert odds(60.0) == "10²⁶ : 1"
    assert (p_value(0.0001, 0.003), p_value(0.25, 0.003)) == ("< 0.003", "0.250")
    assert [rate(f) for f in (None, Fraction(500), Fraction(30000, 1001))] == [
        "–",
        "500 fps",
        "29.97003 fps (30000/1001)",
    ]
    assert [listed(w) for w in ((), ("a",), ("a", "b", "c"))] == ["", "a", "a, b and c"]


@pytest.mark.parametrize(("sd", "text"), [(0.0004, "10.00000 ± 0.00040†"), (0.0006, "10.00000 ± 0.00060")])
def test_a_frequency_known_better_than_a_clock_has_a_mark(sd, text):
    assert hertz(10.0, sd) == text
