"""A record with a measured input through the command line: tables, report, and what does not apply to it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from kit.identified import in_sd
from matplotlib.figure import Figure
from support.command import finished, invoked

import modalcam as mc
from benchmarks.known_input_scenes import (
    DAMPING_RATIOS,
    FILM_MM_PER_PX,
    FILM_RATE_HZ,
    FREQUENCIES_HZ,
    MM_PER_N,
    PARTICIPATION,
    RATE_HZ,
    Record,
    film,
    force_record,
    late_base,
    record,
)
from modalcam.pipeline import load_run

#: Each of a dozen values within this many sd: one in 1000 seeds fails by chance.
_LIMIT = 4.0


def _table(one: Record, path, names=("base", "a", "b", "c"), factor=1.0):
    values = np.column_stack([one.time_s, one.base * factor, one.values])
    np.savetxt(path, values, delimiter=",", header=",".join(("time_s", *names)), comments="", fmt="%.9g")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Results of `modalcam identify --input base`."""
    folder = tmp_path_factory.mktemp("response")
    _table(record("random", 11), folder / "take.csv")
    finished("identify", folder / "take.csv", "-o", folder / "out", "--input", "base", "--unit", "mm")
    return folder / "out"


def test_the_tables_have_modes_participation_and_response(out):
    modes = pd.read_csv(out / "modes.csv")
    for row, hz, zeta in zip(modes.itertuples(), FREQUENCIES_HZ, DAMPING_RATIOS, strict=True):
        assert np.max(np.abs(in_sd(row, hz, zeta))) < _LIMIT, row
    table = pd.read_csv(out / "participation.csv")
    scores = (table.participation - PARTICIPATION.ravel()) / np.hypot(table.participation_sd, 2e-3)
    assert np.max(np.abs(scores)) < _LIMIT, f"simulated {PARTICIPATION.ravel()}, found {table.participation}"
    assert table.modal_mass.isna().all(), "the motion of a base has no modal mass"
    response = pd.read_csv(out / "response" / "take.csv")
    assert set(response.channel) == {"a", "b", "c"}
    peak = response[response.channel == "a"].magnitude.max()
    # At resonance, participation over twice the damping ratio; the motion of the base adds 1.
    expected = np.max(np.abs(PARTICIPATION[:, 0]) / (2.0 * DAMPING_RATIOS))
    assert peak == pytest.approx(expected, rel=0.02), "from 1 over it, and a frequency between two bins"


def test_the_universal_file_holds_the_responses(out):
    """Read by pyuff: function type 5, transmissibility, at the frequencies of the table."""
    pyuff = pytest.importorskip("pyuff")
    sets = pyuff.UFF(str(out / "universal" / "take.uff")).read_sets()
    found = [one for one in sets if one["type"] == 58 and one["func_type"] == 5]
    table = pd.read_csv(out / "response" / "take.csv")
    assert [one["rsp_ent_name"].strip() for one in found] == ["a", "b", "c"]
    for one in found:
        own = table[table.channel == one["rsp_ent_name"].strip()]
        np.testing.assert_allclose(one["x"], own.frequency_hz, rtol=1e-6, err_msg="by the column's width")
        np.testing.assert_allclose(one["data"], own.real + 1j * own.imaginary, rtol=1e-9)


def test_the_report_has_its_section_and_no_decay(out):
    page = (out / "report.html").read_text("utf-8")
    assert "Frequency response to the measured input" in page
    assert "modalcam identify take.csv --unit mm --input base --seed 0" in page, "what the results depend on"
    assert "Response to a measured motion of the base" in page
    for of_decay in ("Probability of this onset", "Length of decay", "Spectrum before and after the fit"):
        assert of_decay not in page, f"{of_decay} is of a decay"


def test_the_interface_gives_the_response(out):
    one = record("random", 11)
    response = mc.frf(one.time_s, one.values, input=one.base)
    table = pd.read_csv(out / "response" / "take.csv")
    own = response.to_dataframe()
    assert list(own.columns) == list(table.columns)
    # The table rounds its input to nine digits.
    np.testing.assert_allclose(own.magnitude, table.magnitude, rtol=1e-4)
    assert own.attrs["units"]["magnitude"] == response.unit
    axes = response.plot(Figure().add_subplot())
    drawn = {line.get_label(): line.get_ydata() for line in axes.lines}
    np.testing.assert_array_equal(drawn[response.channels[1]], np.abs(response.model[:, 1]))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("frequency (Hz)", "response to input (1)")


@pytest.mark.usefixtures("in_process", "no_figures")
def test_a_force_has_modal_masses(tmp_path):
    """The same record, its input called a force: 1 over the modal constant, and its relative sd."""
    _table(record("random", 11), tmp_path / "take.csv", names=("hammer", "a", "b", "c"))
    units = ("--input", "hammer", "--input-unit", "N", "--unit", "mm")
    finished("identify", tmp_path / "take.csv", "-o", tmp_path / "out", *units)
    table = pd.read_csv(tmp_path / "out" / "participation.csv")
    assert set(table.unit) == {"mm/(N s^2)"}
    np.testing.assert_allclose(table.modal_mass * table.participation, 1.0, rtol=1e-6)
    relative = table.modal_mass_sd / table.modal_mass.abs()
    np.testing.assert_allclose(relative, table.participation_sd / table.participation.abs(), rtol=1e-6)


@pytest.mark.usefixtures("in_process", "no_figures")
def test_the_report_states_the_lag_of_the_input(tmp_path):
    """Given, and estimated; in the command that repeats the run as well."""
    one = record("hand", 2)
    rows = one.time_s < one.time_s[0] + 8.0
    _table(Record(one.time_s[rows], one.base[rows], one.values[rows]), tmp_path / "take.csv")
    command = ("identify", tmp_path / "take.csv", "--input", "base", "--unit", "mm", "--input-lag-ms")
    for lag, words in (("-2.5", "was taken to be late by"), ("auto", "estimated with the modes")):
        out = tmp_path / f"out{lag}"
        finished(*command, lag, "-o", out)
        page = (out / "report.html").read_text("utf-8")
        assert words in page
        assert f"--input-lag-ms {lag}" in page


def test_an_input_that_is_no_channel_is_refused_with_the_channels(tmp_path):
    _table(record("random", 11), tmp_path / "take.csv")
    result = invoked("identify", tmp_path / "take.csv", "--input", "clamp", "--unit", "mm")
    assert result.exit_code != 0
    assert "--input clamp" in str(result.exception)
    assert "base, a, b, c" in str(result.exception)


@pytest.mark.usefixtures("in_process", "no_figures")
def test_the_input_is_ignored_with_output_only(tmp_path):
    """Five seconds of a decay beside a channel that does not move, which is no input."""
    one = record("decay", 11)
    rows = one.time_s < one.time_s[0] + 5.0
    short = replace(one, time_s=one.time_s[rows], base=one.base[rows], values=one.values[rows])
    _table(short, tmp_path / "take.csv")
    command = ("identify", tmp_path / "take.csv", "-o", tmp_path / "out", "--unit", "mm", "--input", "base")
    assert "does not move" in invoked(*command).output
    finished(*command, "--output-only", "--force")
    assert not (tmp_path / "out" / "response").exists()
    assert len(pd.read_csv(tmp_path / "out" / "modes.csv")) == FREQUENCIES_HZ.size


@pytest.fixture(scope="module")
def shaken(tmp_path_factory):
    """A film of a clamp that is shaken by hand, and its motion as another recorder shows it, 25 ms late.

    The first frame is 5 ms after the start of the motion.
    """
    folder = tmp_path_factory.mktemp("films")
    film("hand", 1, folder / "take.mkv", span_s=6.0)
    base = late_base("hand", 1, 0.02)[:2400]
    table = np.column_stack([np.arange(base.size) / RATE_HZ, base])
    np.savetxt(folder / "laser.csv", table, delimiter=",", header="time_s,clamp", comments="")
    return folder


def _run(films, out, experiment):
    camera = f"[camera]\nfps = {FILM_RATE_HZ}\nmm_per_px = {FILM_MM_PER_PX}\n[markers]\nkind = 'blob'\n"
    (films / "experiment.toml").write_text(camera + experiment)
    finished("run", films, "-o", out)


def _check_film(out, channels, participation):
    (row,) = pd.read_csv(out / "modes.csv").itertuples()
    scores = in_sd(row, FREQUENCIES_HZ[0], DAMPING_RATIOS[0])
    assert np.max(np.abs(scores)) < _LIMIT, f"frequency and damping ratio are {scores} sd from the film's"
    # So that the limits mean something: 10 s of this film give 1.5 %.
    assert row.damping_ratio_sd < 0.1 * DAMPING_RATIOS[0]
    table = pd.read_csv(out / "participation.csv")
    assert list(table.channel) == channels
    off = (table.participation - participation) / table.participation_sd
    assert np.max(np.abs(off)) < _LIMIT, f"simulated {participation}, found {list(table.participation)}"


@pytest.mark.usefixtures("in_process", "no_figures")
def test_a_marker_on_the_clamp_is_the_input_of_a_film(shaken, tmp_path):
    _run(shaken, tmp_path / "out", 'input = ["m1"]\n')
    _check_film(tmp_path / "out", ["m2", "m3", "m4"], PARTICIPATION[0, ::-1])


@pytest.mark.usefixtures("in_process", "no_figures")
def test_a_file_beside_a_film_holds_its_input(shaken, tmp_path):
    """At twice the rate of the film and late; the marker on the clamp does not move relative to it."""
    entry = "[[recordings]]\nfile = 'take.mkv'\ninput_file = 'laser.csv'\ninput_unit = 'mm'\ninput_lag_ms = 'auto'\n"
    _run(shaken, tmp_path / "out", entry)
    _check_film(tmp_path / "out", ["m1", "m2", "m3", "m4"], np.append(0.0, PARTICIPATION[0, ::-1]))
    response = load_run(tmp_path / "out").recordings[0].identification.response
    off_s = response.input_lag_s - 0.025
    assert abs(off_s) < _LIMIT * response.input_lag_sd_s, f"found {1e3 * response.input_lag_s} ms, not 25"
    again = invoked("run", shaken, "-o", tmp_path / "out").output
    assert "computed take\n" not in again.partition("reading")[2].partition("\n")[2], again
    (shaken / "laser.csv").write_text("time_s,clamp\n0,0\n1,0\n")
    assert "laser.csv: expected at least 8 samples" in invoked("run", shaken, "-o", tmp_path / "out").output


@pytest.mark.usefixtures("in_process", "no_figures")
def test_the_force_of_another_recorder_beside_a_table(tmp_path):
    """Ten impacts of 1.5 ms at 8 kHz, displacements at 400 Hz; the recorder is 12 ms early."""
    one = force_record("impacts", 3, -0.012, span_s=8.0)
    series, force = np.column_stack([one.time_s, one.values]), np.column_stack([one.force_time_s, one.force])
    np.savetxt(tmp_path / "take.csv", series, delimiter=",", header="time_s,a,b,c", comments="", fmt="%.9g")
    np.savetxt(tmp_path / "hammer.csv", force, delimiter=",", header="time_s,force", comments="", fmt="%.9g")
    force = ("--input-file", tmp_path / "hammer.csv", "--input-lag-ms", "-12")
    finished("identify", tmp_path / "take.csv", "-o", tmp_path / "out", "--unit", "mm", *force)
    modes = pd.read_csv(tmp_path / "out" / "modes.csv")
    table = pd.read_csv(tmp_path / "out" / "participation.csv")
    for row, hz, zeta in zip(modes.itertuples(), FREQUENCIES_HZ, DAMPING_RATIOS, strict=True):
        assert np.max(np.abs(in_sd(row, hz, zeta))) < _LIMIT, row
    simulated = MM_PER_N * FREQUENCIES_HZ[0] ** 2 * PARTICIPATION.ravel()
    # The filter changes frequencies of the fit by 2e-4 at most.
    scores = (table.participation - simulated) / np.hypot(table.participation_sd, 2e-4 * simulated)
    assert np.max(np.abs(scores)) < _LIMIT, f"found {list(table.participation)}, simulated {simulated}"
    assert np.isfinite(table.modal_mass).all()
