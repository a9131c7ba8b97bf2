"""Beams whose section changes: frequencies from transfer matrices of the parts, and the meshes of the updating."""

import numpy as np
import pytest
from kit import beams
from scipy.linalg import expm
from support.beams import first_roots

from modalcam.config import BeamConfig, beam_properties
from sim.beam import AncfBeam, BeamProperties, beam_modes
from sim.updating.update import _coarse

BEAM = {**beams.BEAM, "orientation": "none"}
CASES = {
    "thick root": [{"from_mm": 125.0, "thickness_mm": 0.3}],
    "wide middle": [{"from_mm": 200.0, "width_mm": 12.0}, {"from_mm": 300.0}],
    "both": [{"from_mm": 50.0, "width_mm": 8.0, "thickness_mm": 1.0}, {"from_mm": 400.0, "width_mm": 3.0}],
}


def theory_hz(changes, count):
    """Frequencies of Euler and Bernoulli's cantilever: zeros of the moment and shear at the tip of all its parts.

    The state is w, w', M and M'; lengths are in lengths of the beam, EI and mass in those of the section of `BEAM`.
    """
    starts = [0.0, *(one["from_mm"] / 500.0 for one in changes), 1.0]
    widths = [1.0, *(one.get("width_mm", 5.0) / 5.0 for one in changes)]
    heights = [1.0, *(one.get("thickness_mm", 0.5) / 0.5 for one in changes)]

    def determinant(x):
        whole = np.eye(4)
        for start, end, width, height in zip(starts, starts[1:], widths, heights, strict=False):
            rates = np.zeros((4, 4))
            rates[0, 1] = rates[2, 3] = 1.0
            rates[1, 2], rates[3, 0] = 1.0 / (width * height**3), x**4 * width * height
            whole = expm((end - start) * rates) @ whole
        return np.linalg.det(whole[2:, 2:])

    stiffness, mass = 210e9 * 5e-3 * 0.5e-3**3 / 12.0, 8000.0 * 5e-3 * 0.5e-3
    return (first_roots(determinant, count) / 0.5) ** 2 * np.sqrt(stiffness / mass) / (2.0 * np.pi)


@pytest.mark.parametrize("changes", CASES.values(), ids=CASES)
def test_frequencies_with_changes_of_section_are_those_of_theory(changes):
    beam = beam_properties(BeamConfig.model_validate({**BEAM, "elements": 160, "sections": changes}))
    assert not beam.one_section
    error = beam_modes(AncfBeam(beam), 3).frequency_hz / theory_hz(changes, 3) - 1.0
    # the thinnest part of the three has beta = 9.8 / L in mode 3: (beta h)^4 / 1440 = 1e-8
    assert np.abs(error).max() < 1.2e-8, f"160 cubic elements are too stiff by up to 1e-8; got {error}"


def test_a_fine_mesh_is_updated_with_the_fewest_elements_of_one_section_each():
    for elements, start_mm, count in ((100, 250.0, 24), (50, 20.0, 25), (77, 500.0 * 19 / 77, 77)):
        changes = [{"from_mm": start_mm, "thickness_mm": 0.7}]
        fine = beam_properties(BeamConfig.model_validate({**BEAM, "elements": elements, "sections": changes}))
        coarse = _coarse(fine)
        assert coarse.elements == count
        assert isinstance(coarse, BeamProperties)
        np.testing.assert_array_equal(np.unique(coarse.thickness_m), np.unique(fine.thickness_m))
        both = [beam_modes(AncfBeam(beam), 3).frequency_hz for beam in (coarse, fine)]
        # 24 cubic elements, mode 3: (7.9 / 24)^4 / 1440 = 8e-6, more where the beam is thinner than its mean
        np.testing.assert_allclose(*both, rtol=2e-5)
