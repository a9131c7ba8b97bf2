"""Decimated traces keep their extremes."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from modalcam.report.style import min_max

values = st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=400)


@given(values, st.integers(min_value=1, max_value=60), st.randoms(use_true_random=False))
def test_extremes_and_order_are_kept(data, columns, random):
    v = np.array(data)
    t = np.cumsum([random.uniform(0.01, 1.0) for _ in data])
    thin_t, thin_v = min_max(t, v, columns)
    assert thin_t.size <= max(2 * columns, 1)
    assert np.all(np.diff(thin_t) > 0.0)
    index = np.searchsorted(t, thin_t)
    np.testing.assert_array_equal(thin_v, v[index])
    if np.isfinite(v).any():
        assert np.nanmin(thin_v) == np.nanmin(v)
        assert np.nanmax(thin_v) == np.nanmax(v)


def test_each_column_keeps_its_extremes():
    rng = np.random.default_rng(5)
    t, v = np.arange(10_000) / 1000.0, rng.standard_normal(10_000)
    columns = 100
    thin_t, thin_v = min_max(t, v, columns)
    edges = np.linspace(t[0], t[-1], columns + 1)
    for a, b in pairwise(edges):
        inside, thin = (t >= a) & (t < b), (thin_t >= a) & (thin_t < b)
        assert thin_v[thin].min() == v[inside].min()
        assert thin_v[thin].max() == v[inside].max()


def test_gaps_are_kept():
    t, v = np.arange(1000.0), np.zeros(1000)
    v[400:600] = np.nan
    thin_t, thin_v = min_max(t, v, 50)
    assert np.isnan(thin_v[(thin_t >= 420) & (thin_t < 580)]).all()


def test_short_traces_are_unchanged():
    t, v = np.arange(100.0), np.arange(100.0)
    thin_t, thin_v = min_max(t, v, 50)
    assert thin_t is t
    assert thin_v is v
