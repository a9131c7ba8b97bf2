"""A rolling shutter seen in the phases of shapes, against the delay that was simulated; silence without one."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import identification, quick
from kit.series import series_of

from modal_id.modes import readout_note, row_delay

FPS, HEIGHT, CHANNELS = 250.0, 480, 24
ROWS = np.linspace(450.0, 40.0, CHANNELS)
SHARE = (np.arange(CHANNELS) + 0.5) / CHANNELS
SHAPES = (SHARE**1.8, SHARE**2 - 1.3 * SHARE**3)
FREQUENCIES_HZ, RATIOS = (7.3, 41.0), (0.004, 0.002)


def film(per_row_s, seed, noise=0.02):
    """Two decaying modes, each channel sampled when its row is exposed."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(400) / FPS
    exposed_s = time_s[:, None] + per_row_s * ROWS
    values = noise * rng.normal(size=exposed_s.shape)
    for shape, frequency, ratio in zip(SHAPES, FREQUENCIES_HZ, RATIOS, strict=True):
        turns = 2.0 * np.pi * frequency * exposed_s
        values += shape * np.exp(-ratio * turns) * np.cos(turns)
    return series_of(time_s, values)


@pytest.fixture(scope="module")
def found():
    return quick(film(8e-6, 1), onset_s=0.0, seed=1)


def test_the_delay_of_a_row_is_found(found):
    delay = row_delay(found, ROWS)
    assert abs(delay.per_row_s - 8e-6) < 4.0 * delay.sd_s, delay
    # Noise s in samples of a decay e has the variance 2 s^2 / sum(e^2) in each part of an amplitude; the phase of an
    # amplitude a has that over a^2, and omega times the slope over the rows is its regression on them.
    information, time_s = 0.0, np.arange(400) / FPS
    for shape, frequency, ratio in zip(SHAPES, FREQUENCIES_HZ, RATIOS, strict=True):
        omega = 2.0 * np.pi * frequency
        weight = shape**2 * np.sum(np.exp(-2.0 * ratio * omega * time_s)) / (2.0 * 0.02**2)
        information += omega**2 * np.sum(weight * (ROWS - np.average(ROWS, weights=weight)) ** 2)
    # The larger of two estimates, one of them a jackknife over eight groups.
    assert 0.8 < delay.sd_s * np.sqrt(information) < 2.0


def test_the_note_states_the_readout_of_all_rows(found):
    note = readout_note(found, ROWS, HEIGHT)
    stated = float(note.split("readout_s = ")[1].split()[0])
    assert stated == pytest.approx(8e-6 * (HEIGHT - 1), rel=0.05)
    # 16 us for each of 600 rows is longer than a frame of 4 ms: no shutter.
    assert readout_note(found, 0.5 * ROWS, 600) == ""


def test_channels_in_one_row_say_nothing(found):
    assert row_delay(found, np.full(CHANNELS, 200.0)) is None
    assert row_delay(found, np.full(CHANNELS, np.nan)) is None


def simulated(seed, delay_s=0.0, uneven=0.0):
    """Shapes with noise of the stated sd, and errors of the phase that do not follow the rows."""
    rng = np.random.default_rng(seed)
    modes = []
    for shape, frequency in zip(SHAPES, FREQUENCIES_HZ, strict=True):
        phase = 2.0 * np.pi * frequency * delay_s * ROWS + uneven * np.sin(9.0 * SHARE + seed) + 0.4
        noise = 0.003 * rng.normal(size=(2, CHANNELS)).T @ [1.0, 1.0j]
        modes.append(shape * np.exp(1j * phase) + noise)
    return modes


@pytest.fixture(scope="module")
def template():
    modes = [
        (f, z, s.astype(complex), k + 1)
        for k, (f, z, s) in enumerate(zip(FREQUENCIES_HZ, RATIOS, SHAPES, strict=True))
    ]
    return identification(modes, time_s=np.arange(100) / FPS, positions_mm=SHARE, fit_from_s=0.0)


def with_shapes(template, shapes):
    sd = np.full(CHANNELS, 0.003)
    modes = [replace(m, shape=s, shape_sd=sd) for m, s in zip(template.modes, shapes, strict=True)]
    return replace(template, modes=tuple(modes))


@pytest.mark.parametrize("uneven", [pytest.param(0.0, marks=pytest.mark.slow), 0.02])
def test_a_global_shutter_gets_no_note(template, uneven):
    """Also where phases scatter by several times their sd and similarly at neighbours."""
    told = [row_delay(with_shapes(template, simulated(seed, uneven=uneven)), ROWS) for seed in range(150)]
    # Six standard deviations, those of a jackknife over eight groups.
    assert sum(delay is not None for delay in told) == 0


@pytest.mark.parametrize("per_row_s", [pytest.param(8e-6, marks=pytest.mark.slow), -12e-6])
def test_the_sd_of_the_delay_is_that_of_its_error(template, per_row_s):
    delays = [row_delay(with_shapes(template, simulated(seed, per_row_s)), ROWS) for seed in range(60)]
    z = [(delay.per_row_s - per_row_s) / delay.sd_s for delay in delays]
    # The larger of two estimates of the sd is 15 % too large on average. The rms of 60 has a relative sd of 0.09.
    assert 0.55 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_modes_that_disagree_are_no_shutter(template):
    one, other = simulated(1, 8e-6)[0], simulated(1, -8e-6)[1]
    assert row_delay(with_shapes(template, [one, other]), ROWS) is None
