import numpy as np
import pytest

from sim import paper_beam
from sim.beam import BeamProperties, PointMass


def test_uniform_beam_has_the_section_everywhere():
    beam = paper_beam()
    assert beam.elements == 20
    np.testing.assert_allclose(beam.area_m2, 2.5e-6)
    np.testing.assert_allclose(beam.second_moment_m4, 5e-3 * 0.5e-3**3 / 12)
    assert beam.mass_kg == pytest.approx(8000 * 2.5e-6 * 0.5)


def test_scaled_multiplies_each_property():
    beam = paper_beam().scaled(
        width=1.1, thickness=np.linspace(0.9, 1.1, 20), density=0.95, elastic_modulus=1.05
    )
    np.testing.assert_allclose(beam.width_m, 5.5e-3)
    np.testing.assert_allclose(beam.thickness_m, 0.5e-3 * np.linspace(0.9, 1.1, 20))
    assert beam.density_kg_m3 == pytest.approx(7600.0)
    assert beam.elastic_modulus_pa == pytest.approx(220.5e9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length_m": 0.0}, "length_m must be finite and positive, got 0.0"),
        ({"thickness_m": float("nan")}, "thickness_m must be finite and positive"),
        ({"density_kg_m3": -1.0}, "density_kg_m3"),
        ({"orientation": "upwards"}, "orientation must be one of hanging, standing"),
        ({"elements": 0}, "elements must be at least 1"),
        ({"point_masses": (PointMass(0.6, 1e-3),)}, "a point mass is 0.6 m from the clamp"),
    ],
)
def test_invalid_properties_are_refused_by_name(change, message):
    arguments = {
        "length_m": 0.5,
        "width_m": 5e-3,
        "thickness_m": 5e-4,
        "density_kg_m3": 8000.0,
        "elastic_modulus_pa": 210e9,
        "orientation": "hanging",
    } | change
    with pytest.raises(ValueError, match=message):
        BeamProperties.uniform(**arguments)


def test_a_negative_point_mass_is_refused():
    with pytest.raises(ValueError, match="mass_kg of a point mass"):
        PointMass(0.1, -1e-3)


def test_widths_and_thicknesses_must_match():
    with pytest.raises(ValueError, match="one value per element"):
        BeamProperties(0.5, np.full(20, 5e-3), np.full(10, 5e-4), 8000.0, 210e9, "hanging")
