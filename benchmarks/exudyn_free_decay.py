"""Write the reference decay for `tests/sim/dynamics/test_exudyn.py`: ``python -m benchmarks.exudyn_free_decay``.

Exudyn's ANCFCable2D simulates 0.5 s of the paper's hanging beam, released from 200 mm with the modal damping of Eq. 6,
at steps of 20 and 10 us with Newton tolerances of 1e-7 and 1e-8 (tighter ones fail), followed by Richardson
extrapolation. Initial state and damping matrix are modalcam's: the comparison covers elements and time stepping.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.simulation_cases import Decay, beam_and_modes, modal_damping_matrix
from benchmarks.simulation_peers import ExudynBeam, load

FREE_DECAY = Decay("mode 1, 200 mm", 1, 0.2, ())
DURATION_S = 0.5
EVERY_S = 0.01
TARGET = Path(__file__).parents[1] / "tests" / "sim" / "dynamics" / "exudyn_free_decay.csv"


def main() -> None:
    """Run Exudyn and write the file."""
    exu = load()
    beam, modes = beam_and_modes()
    state, matrix = FREE_DECAY.state(beam, modes), modal_damping_matrix(beam, modes)
    tips = [
        ExudynBeam(exu, beam, state, matrix).run(DURATION_S, step_s, EVERY_S, relative=1e-7, absolute=1e-8)[1]
        for step_s in (2e-5, 1e-5)
    ]
    tip = tips[1] + (tips[1] - tips[0]) / 3.0
    change = float(np.abs(tip - tips[1]).max() / FREE_DECAY.tip_m)
    head = (
        f"Exudyn {exu.__version__} ANCFCable2D, 20 elements, tip along and across (m); "
        f"Richardson from 20 and 10 us moved it by {change:.1e} of the amplitude\ntime_s,axial_m,transverse_m"
    )
    time_s = np.arange(tip.shape[0]) * EVERY_S
    np.savetxt(TARGET, np.column_stack([time_s, tip]), delimiter=",", header=head, fmt="%.10g")
    print(head)


if __name__ == "__main__":
    main()
