"""Where modalcam runs changes nothing: locale, time zone, home folder, installed libraries."""

import os
import subprocess
import sys
from importlib import metadata

import matplotlib as mpl
import pytest
from kit.attacks import write_csv
from support.command import finished
from support.paths import ROOT, SAMPLES

from modalcam.commands import Options, identify
from modalcam.config import RecordingConfig
from modalcam.pipeline import Progress

ODD = {"LANG": "C", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
ODD |= {"TZ": "Pacific/Chatham", "HOME": "/proc/none"}


# One figure shows that drawing works there; without a process of its own, which would import for seconds.
ONE_FIGURE = """
import sys
from support.worker_tasks import InThisProcess
from modalcam import cli
from modalcam.pipeline import Progress, pool
from modalcam.report.figures import FIGURES
for key in FIGURES.keys() - {"decay"}:
    del FIGURES[key]
pool.LocalExecutor = InThisProcess
sys.argv[0] = "modalcam"
cli.main()
"""


def test_locale_time_zone_and_home_change_no_result(tmp_path, in_process, no_figures):
    """Only the process in other surroundings draws a figure: the tables of both are compared."""
    csv = tmp_path / "décay.csv"
    write_csv(csv)
    recording = RecordingConfig(file=csv.name)
    identify(csv, Options(tmp_path / "plain"), Progress(), unit="1", recording=recording)
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    environment = os.environ | {"PYTHONPATH": path, "MPLCONFIGDIR": mpl.get_cachedir()} | ODD
    command = [sys.executable, "-c", ONE_FIGURE, "identify", csv.name, "-o", "odd"]
    given = {"cwd": tmp_path, "env": environment, "capture_output": True, "timeout": 240}
    done = subprocess.run(command, **given, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    assert b"\x1b" not in done.stderr
    table = (tmp_path / "plain" / "modes.csv").read_bytes()
    assert b",10." in table
    assert (tmp_path / "odd" / "modes.csv").read_bytes() == table
    assert 'id="r1-decay"' in (tmp_path / "odd" / "report.html").read_text("utf-8")


def test_info_names_two_distributions_of_opencv(monkeypatch):
    class Other:
        metadata = {"Name": "opencv-python"}  # noqa: RUF012

    real = list(metadata.distributions())
    monkeypatch.setattr(metadata, "distributions", lambda: [*real, Other()])
    said = finished("info")
    assert "opencv-python" in said
    assert "opencv-contrib-python-headless" in said
    assert "keep one" in said


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the address space are those of Linux")
@pytest.mark.parametrize(("limit", "megabytes"), [("AS", 150), ("AS", 800), ("DATA", 200), ("DATA", 300)])
def test_libraries_that_do_not_fit_end_in_one_line(tmp_path, limit, megabytes):
    """Importing them would end in a traceback of any of them, or not at all."""
    code = (
        "import resource, sys; from modalcam.__main__ import main;"
        f"resource.setrlimit(resource.RLIMIT_{limit}, ({megabytes} * 2**20,) * 2);"
        "sys.argv[0] = 'modalcam'; main()"
    )
    command = [sys.executable, "-c", code, "track", SAMPLES / "mode5.avi", "-o", tmp_path / "out"]
    given = {"env": os.environ | {"PYTHONPATH": str(ROOT)}, "capture_output": True, "text": True}
    done = subprocess.run(command, **given, timeout=240, check=False)
    assert done.returncode == 2, done.stderr
    assert f"but this process may use {megabytes} MB (RLIMIT_{limit}" in done.stderr
    assert len(done.stderr.splitlines()) == 1
