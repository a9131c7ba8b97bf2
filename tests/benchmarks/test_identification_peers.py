"""The other tools of the identification benchmark must be used rightly: without noise each finds the mode."""

import importlib.util
from dataclasses import asdict

import numpy as np
import pytest

from benchmarks.identification_cost import lines, measured
from benchmarks.identification_peers import PEERS

NEEDS = {"pyOMA2 SSI-cov": "pyoma2", "SDyPy-EMA LSCF": "sdypy"}


@pytest.mark.parametrize(("name", "peer"), PEERS, ids=[name for name, _ in PEERS])
def test_clean_decay(name, peer):
    if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
        pytest.skip(f"{NEEDS[name]} is not installed")
    time_s = np.arange(10_000) / 1000.0
    omega, zeta = 2.0 * np.pi * 26.84, 0.0028
    pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    answer = peer(time_s, np.exp(pole * time_s).real, 26.84)
    assert answer.frequency_hz == pytest.approx(26.84, rel=1e-4)
    # Edges of filters and the curvature of crests cost the simple ones up to 2 %.
    assert answer.zeta == pytest.approx(zeta, rel=0.02)


def test_cost_of_a_long_record_is_measured_and_its_modes_are_found(monkeypatch):
    monkeypatch.setattr("benchmarks.identification_cost._REPETITIONS", 1)
    cost = measured(8000)
    assert (cost.samples, cost.channels, cost.modes) == (8000, 3, 3)
    assert 0.0 < cost.peer_s < cost.cpu_s
    assert f"ratio {cost.ratio:.1f}" in lines([{**asdict(cost), "ratio": cost.ratio}])[0]
