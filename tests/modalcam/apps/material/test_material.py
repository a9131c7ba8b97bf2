"""Intervals, conditions, runs and words of the command."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from kit.bars import bending_stiffness, sandwich_stiffness
from kit.runs import beam_result, paper_recordings, run_result
from support.command import finished, invoked
from support.paths import ROOT

from modalcam.apps.material import (
    MATERIAL_COLUMNS,
    BarMode,
    Quantity,
    Specimen,
    bar_modulus,
    clamped_coefficient,
    departures,
    free_bar_modulus,
    material,
    modes_of,
    oberst_layer,
    of_run,
)
from modalcam.common import InputError
from modalcam.pipeline import load_run
from modalcam.report import build_report
from modalcam.report.style import interval
from modalcam.tables import REGISTERED
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ
from sim.beam import AncfBeam, BeamProperties, PointMass, beam_modes

STRIP = {
    "length_mm": Quantity(300.0, 1.0),
    "width_mm": Quantity(50.0),
    "thickness_mm": Quantity(2.0, 0.01),
    "density_kg_m3": Quantity(2700.0, 10.0),
}
WORDS = ["--length-mm", "300+-1", "--thickness-mm", "2+-.01", "--density-kg-m3", "2700+-10"]


def of(found, name, mode=None):
    (row,) = (v for v in found.values if v.quantity == name and mode in (None, v.mode))
    return row


def test_a_bar_by_hand_and_its_linear_standard_deviation():
    found = of(material(Specimen("bar", **STRIP), [BarMode(2, Quantity(100.0, 0.1))]), "E")
    assert found.value == pytest.approx(12e-9 * 2700 * 0.3**4 * (100.0 / (2e-3 * 3.5069)) ** 2, rel=1e-12)
    # dE/E = 4 dl/l + 2 df/f - 2 dH/H + drho/rho, and 3 sd of the standard deviation of 20 000 draws
    parts = np.array([4.0 / 300.0, 2e-3, 2.0 * 0.005, 10.0 / 2700.0])
    assert found.sd / found.value == pytest.approx(np.linalg.norm(parts), rel=3.0 / np.sqrt(40_000))
    assert found.largest_source == "length"
    assert found.share == pytest.approx(parts[0] ** 2 / np.sum(parts**2), abs=0.02)


def random_case(rng, kind):
    """True sizes of a specimen in SI, its frequencies and damping by theory, and the quantity with its true value."""
    sizes = {
        "length_m": rng.uniform(0.15, 0.5),
        "thickness_m": rng.uniform(1e-3, 4e-3),
        "density_kg_m3": rng.uniform(2000.0, 9000.0),
    }
    e, number = rng.uniform(50e9, 220e9), int(rng.integers(2, 6))
    h, rho = sizes["thickness_m"], sizes["density_kg_m3"]
    if kind == "free-free":
        sizes |= {"width_m": rng.uniform(0.01, 0.03), "poisson_ratio": rng.uniform(0.25, 0.35)}
        mass = rho * sizes["length_m"] * sizes["width_m"] * h
        bar = {k: sizes[k] for k in ("length_m", "width_m", "thickness_m")}
        hz = np.sqrt(e / free_bar_modulus(1.0, sizes["poisson_ratio"], mass_kg=mass, **bar))
        return sizes, BarMode(1, Quantity(float(hz))), None, "E", e
    squared = 2.0 * np.pi * clamped_coefficient(number) / sizes["length_m"] ** 2
    bare_hz = squared * np.sqrt(e * h**2 / 12.0 / rho) / (2.0 * np.pi)
    if kind == "bar":
        return sizes, BarMode(number, Quantity(bare_hz)), None, "E", e
    t, layer_rho, eta = rng.uniform(0.3, 2.0), rng.uniform(800.0, 2000.0), rng.uniform(0.05, 1.0)
    sizes |= {"layer_thickness_m": t * h, "layer_density_kg_m3": layer_rho}
    if kind == "sandwich":
        true, count, name = 10.0 ** rng.uniform(5.5, 7.5), 2, "G1"
        stiffness = sandwich_stiffness(e, h, true * (1.0 + 1j * eta), t * h, np.sqrt(squared))
    else:
        true, count, name = e * 10.0 ** rng.uniform(-2.0, -0.5), 1, "E1"
        stiffness = bending_stiffness([(e, h), (true * (1.0 + 1j * eta), t * h)])
    mass = count * rho * h + layer_rho * t * h
    hz = squared * np.sqrt(stiffness.real / mass) / (2.0 * np.pi)
    zeta = Quantity(0.5 * stiffness.imag / stiffness.real)
    return sizes, BarMode(number, Quantity(hz), zeta), BarMode(number, Quantity(bare_hz)), name, true


def in_mm(sizes):
    """Quantities in SI as a specimen takes them."""
    return {
        name.removesuffix("_m") + "_mm" if name.endswith("_m") else name: (
            Quantity(1e3 * value.value, 1e3 * value.sd) if name.endswith("_m") else value
        )
        for name, value in sizes.items()
    }


def mismeasured(rng, value, relative):
    return Quantity(float(value * np.exp(relative * rng.standard_normal())), relative * value)


def covered(count, kinds=("bar", "oberst", "sandwich", "free-free")):
    """How many 90 % intervals hold the true modulus, of `count` random specimens measured with errors."""
    rng, inside = np.random.default_rng(37), 0
    for k in range(count):
        sizes, one, bare, name, true = random_case(rng, kinds[k % len(kinds)])

        def again(mode):
            zeta = mode.damping_ratio and mismeasured(rng, mode.damping_ratio.value, 0.03)
            return BarMode(mode.number, mismeasured(rng, mode.frequency_hz.value, 1e-3), zeta)

        measured = in_mm({key: mismeasured(rng, value, 0.01) for key, value in sizes.items()})
        specimen = Specimen(kinds[k % len(kinds)], **measured)
        found = of(material(specimen, [again(one)], [again(bare)] if bare else [], seed=k), name)
        scale = 1e-9 * true
        inside += found.q05 <= scale <= found.q95
    return inside


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_intervals_hold_the_true_modulus_of_random_specimens(count):
    # 90 % of them, within 3.3 sd of the binomial: one in a thousand runs with another seed would fail
    least, most = 0.9 * count + 3.3 * np.sqrt(0.09 * count) * np.array([-1.0, 1.0])
    assert least <= covered(count) <= most


def test_a_layer_that_shows_no_stiffness_is_said_to():
    sizes = STRIP | {"layer_thickness_mm": Quantity(1.0, 0.01), "layer_density_kg_m3": Quantity(1e3, 10.0)}
    mass = 1.0 + 0.5 / 2.7
    one = BarMode(2, Quantity(100.0 / np.sqrt(mass), 0.5), Quantity(0.01, 1e-3))
    found = material(Specimen("oberst", **sizes), [one], [BarMode(2, Quantity(100.0, 0.5))])
    assert of(found, "E1").q05 < 0.0 < of(found, "E1").q95
    assert any(c.state == "does not hold" and "reaches 0 in mode 2" in c.text for c in found.conditions)


def test_gravity_and_a_mass_are_taken_out():
    """Against the frequency by Rayleigh's quotient with the exact shape of the bare bar, an upper bound."""
    sizes = {"length_m": 0.5, "width_m": 0.02, "thickness_m": 1e-3, "density_kg_m3": 7800.0}
    e, place, mass = 200e9, 0.3, 1e-3
    beam = BeamProperties.uniform(
        **sizes, elastic_modulus_pa=e, orientation="hanging", point_masses=(PointMass(place, mass),)
    )
    hz = beam_modes(AncfBeam(beam), 1).frequency_hz[0]
    apparent = bar_modulus(hz, 1, length_m=0.5, thickness_m=1e-3, density_kg_m3=7800.0)
    specimen = Specimen("bar", **in_mm({name: Quantity(value) for name, value in sizes.items()}))
    departure = departures(beam, specimen, {1: float(apparent)})[1]
    assert not departures(beam, specimen, {2 * beam.elements + 1: 1.0}), "more modes than the mesh has"
    # C_1 has five digits; the mesh of both beams is the same, its error of 1e-6 cancels
    assert apparent / (1.0 + departure) == pytest.approx(e, rel=2e-5)
    x, step = np.linspace(0.0, 1.0, 4001, retstep=True)
    beta = 1.8751040687
    sigma = (np.sinh(beta) - np.sin(beta)) / (np.cosh(beta) + np.cos(beta))
    w = np.cosh(beta * x) - np.cos(beta * x) - sigma * (np.sinh(beta * x) - np.sin(beta * x))
    slope = np.gradient(w, step)
    own = sizes["density_kg_m3"] * 0.02 * 1e-3 * 0.5
    # tension: the weight below each point, in units of the beam's weight
    tension = own * (1.0 - x) + mass * (x <= place / 0.5)
    strain = e * 0.02 * 1e-9 / 12.0 * beta**4 / 0.5**3 * np.mean(w**2)
    lift = 9.80665 * np.mean(tension * slope**2) / 0.5
    added = mass * np.interp(place / 0.5, x, w) ** 2 / (own * np.mean(w**2))
    quotient = (1.0 + lift / strain) / (1.0 + added) - 1.0
    # The quotient is above the frequency by the square of the change of shape: 3 % of the change suffice.
    assert departure == pytest.approx(quotient, rel=0.03)
    assert departure <= quotient


def test_what_is_computed_from_a_size_without_sd_has_no_interval():
    sizes = {"length_mm": (500.0, 0.5), "thickness_mm": (0.5, np.nan), "density_kg_m3": (8000.0, 10.0)}
    specimen = Specimen("bar", **{name: Quantity(*value) for name, value in sizes.items()})
    found = material(specimen, [BarMode(2, Quantity(10.19, 1e-3), Quantity(0.0028, 1e-5))])
    e, eta = of(found, "E", 2), of(found, "loss_factor", 2)
    assert np.isnan([e.sd, e.q05, e.q95]).all()
    assert eta.sd == pytest.approx(2e-5, rel=0.03), "it does not depend on the sizes"
    assert any("thickness_mm" in note and "no interval" in note for note in found.notes)


def test_the_samples_have_the_moduli_and_loss_factors_of_the_truth(samples_run):
    result = load_run(samples_run)
    modes, _ = modes_of(result)
    sizes = {"length_mm": 500.0, "width_mm": 5.0, "thickness_mm": 0.5, "density_kg_m3": 8000.0}
    specimen = Specimen("bar", **{name: Quantity(value, 0.0) for name, value in sizes.items()})
    found = material(specimen, modes, beam=result.beam.standard)
    within = 0
    for number, hz, zeta in zip(range(1, 6), MEASURED_FREQUENCY_HZ, MEASURED_DAMPING_RATIO, strict=True):
        e, eta = of(found, "E", number), of(found, "loss_factor", number)
        si = {"length_m": 0.5, "thickness_m": 0.5e-3, "density_kg_m3": 8000.0}
        true = 1e-9 * float(bar_modulus(hz, number, **si))
        # four standard deviations: one of ten values in 1600 such runs
        assert abs(e.value - true) < 4.0 * e.sd
        assert abs(eta.value - 2.0 * zeta) < 4.0 * eta.sd
        within += (e.q05 <= true <= e.q95) + (eta.q05 <= 2.0 * zeta <= eta.q95)
    assert within >= 7, "of ten 90 % intervals, fewer hold the truth with a probability of 0.013"
    states = {c.text.partition(":")[0]: c.state for c in found.conditions}
    assert states["Gravity, point masses and the clamp of [beam] are negligible"] == "does not hold"


def test_a_run_writes_the_moduli_of_its_bar_without_an_interval(samples_run):
    table = pd.read_csv(samples_run / "material.csv").set_index(["quantity", "mode"])
    assert list(table.loc["E"].index) == [1, 2, 3, 4, 5]
    sizes = {"length_m": 0.5, "thickness_m": 0.5e-3, "density_kg_m3": 8000.0}
    for number, row in table.loc["E"].iterrows():
        expected = 1e-9 * float(bar_modulus(row.frequency_hz, number, **sizes))
        assert row.value == pytest.approx(expected, rel=1e-12)
    assert table.loc["E", ["sd", "q05", "q95"]].isna().all(axis=None), "[beam] has no standard deviations"
    assert (table.loc["loss_factor", "sd"] > 0.0).all()
    page = (ROOT / "docs" / "files.md").read_text("utf-8")
    assert f"| `material.csv` | {REGISTERED['material.csv'].about} |" in page


SDS = "length_sd_mm = 1.0\nthickness_sd_mm = 0.005\ndensity_sd_kg_m3 = 0.0\n"


@pytest.mark.parametrize("sds", ["", SDS], ids=["no sd", "sd"])
def test_the_section_of_the_report_has_intervals_where_beam_has_standard_deviations(sds):
    beam = f"[beam]\nlength_mm = 500.0\nwidth_mm = 5.0\nthickness_mm = 0.5\ndensity_kg_m3 = 8000.0\n{sds}"
    run = run_result(paper_recordings(2), beam=beam_result(), resolved_config=beam)
    found = material(**of_run(run))
    page = build_report(replace(run, added={"material": found}), plots="static")
    section = re.search(r'<div class="anchor" id="material">.*?</details>', page, re.DOTALL)[0]
    assert '<a href="#material">Material</a>' in page
    assert "computed with the equations of ASTM E756-05(2017)" in section
    assert "conform" not in section
    for state in ("Holds.", "Does not hold.", "Not known."):
        count = sum(f"{c.state}." == state.lower() for c in found.conditions)
        assert section.count(f"<strong>{state}</strong>") == count
    e, eta = of(found, "E", 2), of(found, "loss_factor", 2)
    assert f'<data value="{e.value}">' in section
    assert interval(eta.q05, eta.q95, eta.sd) in section
    assert ("set length_sd_mm, thickness_sd_mm and density_sd_kg_m3 in [beam]" in section) == (not sds)
    if sds:
        assert interval(e.q05, e.q95, e.sd) in section
        # dE/E = 4 dl/l - 2 dH/H, and 3 sd of the standard deviation of 20 000 draws
        assert e.sd / e.value == pytest.approx(np.hypot(4.0 / 500.0, 2.0 * 0.01), rel=3.0 / np.sqrt(40_000))
        assert f"thickness, {100 * e.share:.0f}" in section.replace("\N{NO-BREAK SPACE}", " ")


def test_only_a_clamped_bar_with_numbered_modes_has_moduli():
    """Without the material there is neither section nor link, and no table."""
    run = run_result(paper_recordings(2), beam=beam_result())
    held = replace(run.beam, standard=replace(run.beam.standard, ends=("clamped", "clamped")))
    thin = replace(run.beam, standard=run.beam.standard.scaled(thickness=np.repeat([1.0, 0.9], 10)))
    for change in ({"beam": None}, {"beam": held}, {"beam": thin}, {"recordings": ()}):
        assert of_run(replace(run, **change)) is None
    assert "#material" not in build_report(run, plots="static")


def test_a_layer_from_two_runs(samples_run, tmp_path):
    """Both runs are the same: the layer adds mass, but the frequency stays, so that a is 1 + D T."""
    out = tmp_path / "layer.csv"
    layer = ["--layer-thickness-mm", "0.25+-.01", "--layer-density-kg-m3", "1600+-10", "--specimen", "oberst"]
    finished("material", samples_run, "--base", samples_run, *layer, "-o", out)
    table = pd.read_csv(out).set_index(["mode", "quantity"])["value"]
    for number in range(1, 6):
        e, eta = table[number, "E"], table[number, "loss_factor"]
        expected = oberst_layer(1.0 + 0.2 * 0.5, eta, base_modulus_pa=e, thickness_ratio=0.5)
        assert table[number, "E1"] == pytest.approx(float(expected.real), rel=1e-9)


def test_the_command_writes_the_columns_of_the_registry(tmp_path):
    out = tmp_path / "material.csv"
    words = ["material", *WORDS, "--mode", "1:18+-.1:0.002+-.0001", "--mode", "2:107+-.1", "-o", out]
    shown = finished(*words)
    assert "Computed with the equations of ASTM E756-05(2017)." in shown
    assert "conform" not in shown
    table = pd.read_csv(out)
    assert list(table.columns) == [column.name for column in MATERIAL_COLUMNS]
    assert list(table.quantity) == ["E", "loss_factor", "E"]
    first = out.read_bytes()
    finished(*words, "--force")
    assert out.read_bytes() == first


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--mode", "1:18"], "expected --length-mm, --thickness-mm, --density-kg-m3; found only none"),
        ([*WORDS], "expected either OUT, a finished run, or --mode; found neither"),
        ([*WORDS, "--mode", "18"], "expected NUMBER:HZ"),
        ([*WORDS, "--mode", "1:-18"], "expected a positive VALUE"),
        ([*WORDS, "--mode", "1:18", "--mode", "1:19"], "each mode once"),
        ([*WORDS, "--mode", "1:18", "--mass-g", "5"], "expected no other value; found --mass-g"),
        ([*WORDS, "--mode", "1:18", "--base-mode", "1:18"], "expected only with --specimen oberst"),
        ([*WORDS, "--mode", "1:18", "--specimen", "plate"], "expected one of bar, oberst"),
        ([*WORDS, "--width-mm", "9", "--mode", "1:18", "--specimen", "free-free"], "--torsion-hz; found neither"),
    ],
)  # fmt: skip
def test_what_cannot_be_computed_is_refused(words, message):
    refused = invoked("material", *words)
    assert isinstance(refused.exception, InputError)
    assert message in str(refused.exception)
