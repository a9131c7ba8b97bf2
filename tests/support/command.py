"""Commands of modalcam, called in the process of the test, which is that of their workers, too."""

import pytest
from support.worker_tasks import InThisProcess
from typer.testing import CliRunner

from modalcam.cli import app


def invoked(*words):
    """The result of ``modalcam WORDS``."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("modalcam.pipeline.pool.LocalExecutor", InThisProcess)
        return CliRunner().invoke(app, list(map(str, words)))


def finished(*words):
    """The output of ``modalcam WORDS``, which must succeed."""
    result = invoked(*words)
    assert result.exit_code == 0, result.output
    return result.output
