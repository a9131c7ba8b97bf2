"""Exudyn with the deck's damping matrix against our simulation with the same ratios."""

import numpy as np
import pytest

from sim import MEASURED_DAMPING_RATIO, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping
from sim.dynamics import released_state, simulate

TIP_M, DURATION_S, EVERY_S = 1e-3, 0.4, 2e-3


# benchmarks writes names that Exudyn renamed in 1.12 and reads until 2031, so that older versions run too.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("number", "step_s"), [(2, 2e-4), (3, 5e-5)])
def test_the_decay_of_exudyn_with_the_deck_is_ours(number, step_s):
    pytest.importorskip("exudyn")
    deck = pytest.importorskip("modalcam.apps.deck", reason="an installation without apps").deck
    from kit.decks import paper_damping, read_by_the_code

    from benchmarks.simulation_peers import ExudynBeam, load

    beam = AncfBeam(paper_beam(), 5)
    modes = beam_modes(beam, 8)
    state = released_state(beam, modes, number, TIP_M)
    rest = released_state(beam, modes, number, 0.0)
    undamped = np.zeros((state.q.size, state.q.size))
    mass, stiffness = ExudynBeam(load(), beam, rest, undamped, matrix_in_tangent=True).linearised()
    made = {}
    exec("\n".join(read_by_the_code(deck(paper_damping(), "exudyn"), "exudyn")), made)  # noqa: S102 - our own deck
    # The clamp holds the four coordinates of the first node.
    matrix = made["modal_damping_matrix"](mass, stiffness, np.arange(4, mass.shape[0]))
    theirs = ExudynBeam(load(), beam, state, matrix[4:, 4:], matrix_in_tangent=True).run(
        DURATION_S, step_s, EVERY_S
    )[1]
    law = GenericDamping(MEASURED_DAMPING_RATIO, residual_ratio=0.0)
    given = {"duration_s": DURATION_S, "step_s": step_s, "output_every": round(EVERY_S / step_s)}
    at_m = np.array([beam.properties.length_m])
    run = simulate(beam, law, state=state, output_positions_m=at_m, modes=modes, **given)
    difference = np.abs(run.transverse_m[:, 0] - theirs[: run.time_s.size, 1]).max() / TIP_M
    assert difference < 1e-3, (
        "its steps shift the phase by (omega h)^2 omega T / 12 = 4e-4 in both modes, and the modes of both linearised "
        f"models differ by the mesh error, 1e-4 at most; found {difference:.1e} of the tip"
    )
