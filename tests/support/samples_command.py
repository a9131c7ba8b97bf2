"""``python -m support.samples_command ARGUMENTS``: `modalcam ARGUMENTS` in one process, the report without figures.

Worker processes and the figures of a report are those of test_commands.py; both would double the time of this command.
"""

import sys

from support.worker_tasks import InThisProcess

from modalcam import cli
from modalcam.pipeline import pool
from modalcam.report.figures import registry

if __name__ == "__main__":
    sys.argv[0] = "modalcam"
    pool.LocalExecutor = InThisProcess
    registry.FIGURES.clear()
    cli.main()
