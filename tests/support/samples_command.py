"""``python -m support.samples_command ARGUMENTS``: `modalcam ARGUMENTS` in one process, the report without figures.

Worker processes and the figures of a report are those of test_commands.py; both would double the time of this command.
Bands have 12 draws instead of 32. They are prediction intervals for any number of draws; what grows is the scatter of
their width, 1 / sqrt(2 (n - 1)), from 13 to 21 %. The coverage of five recordings then has an sd of 0.03: 2 * 1.645
times the normal density there, 0.103, times 0.21 / sqrt(5).
"""

import sys
from dataclasses import replace

from support.worker_tasks import InThisProcess

from modalcam import cli
from modalcam.pipeline import pool
from modalcam.report.figures import registry
from sim.comparison import bands

if __name__ == "__main__":
    sys.argv[0] = "modalcam"
    pool.LocalExecutor = InThisProcess
    registry.FIGURES.clear()
    bands.TUNING = replace(bands.TUNING, draws=12)
    cli.main()
