"""A run with newly compiled kernels and one worker, and one with cached kernels and two workers: the same bytes."""

import hashlib
import os
import subprocess
import sys

import pytest
from support.paths import ROOT

from benchmarks.film_scenes import Film

FILMS = (Film("dots", "MJPG", 1.0, 160, 1), Film("dots", "H.264", 1.0, 160, 2))


def results(folder):
    """SHA-256 of every result that is not about the run itself."""
    files = [p for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix in (".csv", ".nc", ".uff")]
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_cold_and_warm_runs_with_one_and_two_workers_write_the_same_bytes(tmp_path):
    """Lossy footage with learned templates, on which rounding once decided between two results."""
    footage = tmp_path / "footage"
    footage.mkdir()
    (footage / "experiment.toml").write_text('[camera]\nfps = 500.0\n[markers]\nkind = "blob"\n')
    for film in FILMS:
        path = film.write(footage)
        path.rename(footage / f"take{film.seed}{path.suffix}")
    cache = tmp_path / "numba"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    found = []
    for jobs in (1, 2):
        assert bool(list(cache.rglob("*.nbc"))) == (jobs == 2), "the first run must compile, the second not"
        out = tmp_path / f"out{jobs}"
        command = [sys.executable, "-m", "modalcam", "run", str(footage), "-o", str(out), "--jobs", str(jobs)]
        subprocess.run(command, env=environment, check=True, capture_output=True, cwd=ROOT)
        found.append(results(out))
    assert any("tracks" in name for name in found[0]), f"no tracks among {sorted(found[0])}"
    assert "modes.csv" in found[0], f"no modes among {sorted(found[0])}"
    differing = sorted(name for name in found[0] if found[0][name] != found[1].get(name))
    assert found[0].keys() == found[1].keys()
    assert not differing, f"these files differ between a cold run and a warm one: {', '.join(differing)}"
