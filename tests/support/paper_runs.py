"""The paper's recomputed numbers, and a run with the values of its Table 2."""

from functools import cache

from support import report_runs as runs

from modalcam.apps.paper import recompute
from modalcam.pipeline import BeamResult
from sim import paper_beam

paper = cache(recompute)


@cache
def run_of_table_2():
    """Decays with Table 2's frequencies and damping ratios, of the paper's beam."""
    beam = BeamResult(
        standard=paper_beam(),
        standard_modes=runs.beam_theory(),
        updated=paper().optimum.to_test,
        rayleigh_alpha_1_s=runs.RAYLEIGH_ALPHA_1_S,
        rayleigh_beta_s=runs.RAYLEIGH_BETA_S,
    )
    return runs.run_result(runs.compared(runs.paper_recordings()), beam=beam)
