"""Python interface: a beam in millimetres and its modes."""

import matplotlib as mpl
import numpy as np
import pytest

from sim import paper_beam
from sim.beam import AncfBeam, Beam, beam_modes, natural_modes

PAPER = {
    "length_mm": 500,
    "width_mm": 5,
    "thickness_mm": 0.5,
    "density_kg_m3": 8000,
    "elastic_modulus_mpa": 210_000,
}


def test_millimetres_give_the_paper_beam():
    made, expected = Beam(**PAPER).properties, paper_beam()
    assert made.orientation == "hanging"
    for name in ("length_m", "density_kg_m3", "elastic_modulus_pa", "width_m", "thickness_m"):
        np.testing.assert_allclose(getattr(made, name), getattr(expected, name), rtol=1e-15)


def test_widths_and_thicknesses_may_be_lists():
    beam = Beam(**{**PAPER, "width_mm": [5, 6, 7], "thickness_mm": [0.5, 0.4, 0.3], "elements": 3})
    np.testing.assert_allclose(beam.properties.width_m, [5e-3, 6e-3, 7e-3])
    assert repr(beam) == "Beam(500 x 6 x 0.4 mm, 8000 kg/m3, 210000 MPa, hanging, 3 elements)"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"length_mm": -1}, "length_mm must be finite and positive, got -1"),
        ({"thickness_mm": [0.5, 0.0]}, "thickness_mm must be finite and positive"),
        ({"width_mm": [5, 6]}, r"width_mm must be one number or one per element \(20\)"),
        ({"elements": 0}, "elements must be at least 1"),
        ({"orientation": "upside down"}, "orientation must be one of"),
    ],
)
def test_invalid_beams_are_refused(changes, expected):
    with pytest.raises(ValueError, match=expected):
        Beam(**{**PAPER, **changes})


def test_modes_match_the_assembled_beam():
    modes = natural_modes(Beam(**PAPER))
    np.testing.assert_allclose(
        modes.omega_rad_s, beam_modes(AncfBeam(paper_beam()), 5).omega_rad_s, rtol=1e-12
    )
    assert repr(modes) == "BeamModes(5 modes: 1.88, 10.6, 29.3, 57.1, 94.3 Hz)"
    table = modes.to_dataframe()
    assert table.columns.tolist() == ["mode", "frequency_hz"]
    assert table["mode"].tolist() == [1, 2, 3, 4, 5]


def test_modes_are_plotted_on_the_given_axes():
    mpl.use("agg")
    from matplotlib.figure import Figure

    ax = Figure().add_subplot()
    modes = natural_modes(Beam(**PAPER), 2)
    assert modes.plot(ax) is ax
    assert len(ax.lines) == 2
    assert max(np.max(np.abs(line.get_ydata())) for line in ax.lines) == 1.0


def test_a_beam_in_other_units_is_refused_with_the_likely_ones():
    with pytest.raises(
        ValueError, match=r"in g/cm3, write 8000; .* in Pa, write 210000; .* in metres, write 500"
    ):
        Beam(length_mm=0.5, width_mm=5, thickness_mm=0.5, density_kg_m3=8.0, elastic_modulus_mpa=210e9)
