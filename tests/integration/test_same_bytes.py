"""The same bytes for any number of worker processes, and from saved results."""

import hashlib
import subprocess
import sys

import pytest
from support.decay_clip import write_decay
from support.paths import ROOT

pytestmark = pytest.mark.timeout(900)


def run_modalcam(*args):
    command = [sys.executable, "-m", "modalcam", *map(str, args)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=840, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def contents(folder):
    """Hash of every file of an output folder; the lock names the process that wrote it."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "lock"
    }


def test_one_worker_two_workers_and_saved_results_give_the_same_bytes(tmp_path):
    videos, one, two = (tmp_path / name for name in ("videos", "one", "two"))
    videos.mkdir()
    write_decay(videos)
    write_decay(videos, name="again", seed=2)
    assert run_modalcam("run", videos, "-o", one, "--jobs", 1) == str(one / "report.html")
    run_modalcam("run", videos, "-o", two, "--jobs", 2)
    before = contents(one)
    assert contents(two) == before
    run_modalcam("report", one, "--jobs", 1)
    assert contents(one) == before
