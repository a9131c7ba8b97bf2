"""An ambient record through the command line: tables, report, and what does not apply to it."""

import numpy as np
import pandas as pd
import pytest
from kit.beams import experiment
from support.command import finished

import modalcam as mc
from benchmarks.ambient_scenes import FILMED_MM, ambient_film, response, series_of
from sim import sample_beam
from sim.beam import AncfBeam, beam_modes

RATE_HZ, HZ, ZETA = 40.0, 4.0, 0.02


def record():
    """Five minutes of one mode in two channels."""
    rng = np.random.default_rng(11)
    n = int(300.0 * RATE_HZ)
    motion = response(np.array([HZ]), np.array([ZETA]), np.eye(1), n, 1.0 / RATE_HZ, rng)
    return series_of(motion * [1.0, -0.6] + 0.01 * rng.standard_normal((n, 2)), RATE_HZ)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Results of `modalcam identify --excitation ambient`."""
    folder = tmp_path_factory.mktemp("ambient")
    table = record().to_dataframe()
    table[["time_s", "m1_mm", "m2_mm"]].to_csv(folder / "take.csv", index=False)
    finished("identify", folder / "take.csv", "-o", folder / "out", "--excitation", "ambient")
    return folder / "out"


def test_the_table_has_the_mode(out):
    """Within 4 sd."""
    row = pd.read_csv(out / "modes.csv").iloc[0]
    assert abs(row.frequency_hz - HZ) < 4.0 * row.frequency_sd_hz
    assert abs(row.damping_ratio - ZETA) < 4.0 * row.damping_ratio_sd


def test_the_report_has_its_section_and_no_decay(out):
    """Spectrum with bands, the law in words, and no onset."""
    page = (out / "report.html").read_text("utf-8")
    assert "Spectrum of the ambient vibration" in page
    assert "min would give" in page
    assert "Length of record" in page
    for of_decay in ("Probability of this onset", "Length of decay", "Spectrum before and after the fit"):
        assert of_decay not in page, f"{of_decay} is of a decay"


def test_the_interface_gives_the_same(out):
    """The values of the table, whose seed differs: the posterior medians agree to a tenth of a sd."""
    series = record()
    found = mc.identify(series.time_s, series.values, excitation="ambient")
    row = pd.read_csv(out / "modes.csv").iloc[0]
    assert found.modes[0].frequency_hz == pytest.approx(row.frequency_hz, abs=0.1 * row.frequency_sd_hz)
    assert found.ambient.bands
    found.plot()


@pytest.mark.usefixtures("in_process", "no_figures")
@pytest.mark.parametrize("minutes", [1.0, pytest.param(5.0, marks=pytest.mark.slow)])
def test_a_film_of_the_sample_beam_in_the_wind(tmp_path, minutes):
    """Two modes of the beam of the samples, moved by random forces, from the film to the numbered modes."""
    films, zeta = tmp_path / "films", np.array([0.02, 0.01])
    films.mkdir()
    beam = beam_modes(AncfBeam(sample_beam()), 2)
    ambient_film(beam, zeta, films / "take.mkv", seed=1, duration_s=60.0 * minutes, rate_hz=30.0)
    camera = f"[camera]\nfps = 30\nmm_per_px = 1.0\n[markers]\nkind = 'blob'\npositions_mm = {FILMED_MM.tolist()}\n"
    (films / "experiment.toml").write_text(experiment(camera, elements=10))
    finished("run", films, "-o", tmp_path / "out", "--excitation", "ambient")
    modes = pd.read_csv(tmp_path / "out" / "modes.csv")
    assert list(modes["mode"]) == [1, 2], "those of the simulation, by frequencies and shapes of theory"
    off_f = (modes.frequency_hz - beam.frequency_hz[:2]) / modes.frequency_sd_hz
    relative_sd = modes.damping_ratio_sd / modes.damping_ratio
    off_zeta = np.log(modes.damping_ratio / zeta) / relative_sd
    # Normal in the logarithm of zeta; four values, each within 4 sd: one seed in 4000 fails by chance.
    assert np.max(np.abs([off_f, off_zeta])) < 4.0, f"off by {list(off_f)} and {list(off_zeta)} sd"
    # So that the limits mean something: a minute should give 27 and 16 % by the law of a long record.
    assert (relative_sd < 0.5).all(), f"relative sd of the damping ratios {list(relative_sd)}"
