"""Shapes that contradict theory: a clamp given at the wrong end, positions in reverse; and those that do not."""

import numpy as np
import pytest
from kit.series import QUICK, pole_of, series_of

from modal_id import IdentifySettings, ModeFlag, identify
from sim import paper_beam
from sim.beam import AncfBeam, beam_modes
from tracker import Severity

MODES = beam_modes(AncfBeam(paper_beam()), 8)
LENGTH_M = 0.5
T = np.arange(1200) / 400.0
SD = 0.01


def found(positions_m, mode, seed, *, believed_m, noise=SD, stiffer=1.0):
    """Identified modes of a decay of one mode, with theory for `believed_m`."""
    rng = np.random.default_rng([seed, mode])
    hz = MODES.frequency_hz[mode - 1] * stiffer
    shape = MODES.transverse_at(positions_m)[:, mode - 1]
    motion = np.real(np.exp(T[:, None] * pole_of(hz, 0.003)) * shape / np.abs(shape).max())
    settings = IdentifySettings(
        mode=mode,
        onset_s=0.0,
        sampler=QUICK,
        expected_frequencies_hz=tuple(MODES.frequency_hz),
        expected_shapes=MODES.transverse_at(believed_m),
        reversed_shapes=MODES.transverse_at(LENGTH_M - believed_m),
    )
    return identify(series_of(T, motion + noise * rng.standard_normal(motion.shape)), settings).modes


def flagged(modes):
    return [ModeFlag.SHAPE_DISAGREES.name in mode.flags for mode in modes]


@pytest.mark.parametrize(
    ("mode", "markers"),
    [
        *((mode, 3) for mode in range(1, 6)),
        (4, 8),
        *(pytest.param(mode, 8, marks=pytest.mark.slow) for mode in (1, 2, 3, 5)),
    ],
)
def test_a_clamp_at_the_wrong_end_is_named(mode, markers):
    at = np.linspace(0.04, 0.48, markers)
    (only,) = found(at, mode, 1, believed_m=LENGTH_M - at)
    assert flagged([only]) == [True]
    assert dict(only.severities)["SHAPE_DISAGREES"] == Severity.WRONG.name
    assert (
        f"Shape disagrees with theory (MAC {only.mac:.2g}); with the clamp at the other end 1." in only.notes
    )


def test_a_clamp_at_the_wrong_end_is_named_where_both_shapes_are_alike():
    at = np.array([0.07, 0.17, 0.20, 0.23, 0.34, 0.43])
    (only,) = found(at, 3, 1, believed_m=LENGTH_M - at)
    assert only.mac > 0.8, "two shapes of one mode may have a MAC as low"
    assert "with the clamp at the other end 1." in " ".join(only.notes)


def test_positions_in_reverse_are_named():
    at = np.array([0.06, 0.17, 0.29, 0.41])
    (only,) = found(at, 4, 1, believed_m=at[::-1])
    assert flagged([only]) == [True]


@pytest.mark.parametrize(
    ("mode", "counts"),
    [(5, (1, 3)), *(pytest.param(n, (1, 2, 2, 3, 5, 8), marks=pytest.mark.slow) for n in range(1, 6))],
)
def test_shapes_of_theory_are_not_blamed(mode, counts):
    """With noise up to the amplitude, few markers, positions read to 2 mm and a stiffer beam."""
    rng = np.random.default_rng(mode)
    for seed, markers in enumerate(counts):
        at = np.sort(rng.uniform(0.03, 0.49, markers))
        believed = np.clip(at + 0.002 * rng.standard_normal(markers), 0.0, LENGTH_M)
        modes = found(at, mode, seed, believed_m=believed, noise=(0.01, 0.1, 0.5)[seed % 3], stiffer=1.03)
        assert not any(flagged(modes)), f"markers at {at}"
