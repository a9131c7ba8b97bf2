"""Kernels are compiled once, the lists of them are complete, and the cache of another processor is not used."""

import math
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.kernel_cache import kernels, listed, python
from support.paths import ROOT

from modalcam.pipeline import (
    DECAYS,
    DIVISION,
    FILMS,
    GROUPS,
    LINES,
    MARKERS,
    SIMULATION,
    Progress,
    WorkerPool,
    compile_kernels,
)

NAMES = ("LINES", "MARKERS", "SIMULATION", "DIVISION", "DECAYS", "FILMS")
COMPILE = """
from modalcam.pipeline import compile
for name in {names}:
    print("group", name)
    compile._compile(getattr(compile, name))
    compile._function(getattr(compile, name).compiling)()
"""
# With ten stations: each is tracked by the same kernels.
TRACK_BARE = """
from support.paths import ROOT
from modalcam.config.resolve import tracker_settings
from modalcam.config.toml import load_config
from tracker.track import track
folder = ROOT / "sample_bare"
settings = tracker_settings(load_config(folder / "experiment.toml").for_recording("mode3.avi"))
track(folder / "mode3.avi", settings.model_copy(update={"stations": 10}))
"""
# What the first command and the next say of the kernels of synthetic films.
TWO_COMMANDS = """
from support.worker_tasks import InThisProcess
from modalcam.pipeline.pool import WorkerPool
from modalcam.pipeline.stage import Progress
from modalcam.pipeline.compile import FILMS, STAGE, compile_kernels
class Told(Progress):
    def begin(self, stage, total):
        print("begin", stage == STAGE, total)
    def advance(self, name):
        print("advance")
for command in ("first", "next"):
    print(command)
    compile_kernels(WorkerPool(InThisProcess().submit, None, on_this_machine=True), Told(), [FILMS])
"""
# Whether the kernels of synthetic films are missing, after they have been compiled here, and one of them.
FILM_KERNELS = """
from modalcam.pipeline.compile import FILMS, _compile, missing
from sim.render.kernels import fast_erf
before = len(missing(FILMS))
_compile(FILMS)
print(before, len(missing(FILMS)), *(repr(fast_erf(0.1 * k)) for k in range(-30, 31)))
"""


@pytest.fixture(scope="module")
def called():
    """Kernels that each group calls from Python, where all are compiled."""
    report = python(COMPILE.format(names=NAMES), NUMBA_DEBUG_CACHE="1")
    if kernels(report, "saved to"):
        # A kernel that was compiled for another one looks like a called one.
        report = python(COMPILE.format(names=NAMES), NUMBA_DEBUG_CACHE="1")
    parts = report.split("group ")[1:]
    return {part.split()[0]: kernels(part, "loaded from") for part in parts}


def test_each_group_lists_what_it_calls(called):
    assert set(GROUPS) == {LINES, MARKERS, SIMULATION, DIVISION, DECAYS, FILMS}
    for name, group in zip(NAMES, (LINES, MARKERS, SIMULATION, DIVISION, DECAYS, FILMS), strict=True):
        assert called[name] == listed(group), f"{name} of modalcam/pipeline/compile.py must list its calls"


@pytest.mark.timeout(900)
def test_a_run_of_the_sample_videos_needs_no_other_kernel(samples_run):
    found = kernels((samples_run.parent / "kernels.txt").read_text(encoding="utf-8"))
    assert {"fits.follow_plain", "march.march", "reduction.chi_square_of"} <= found
    more = found - listed(MARKERS, SIMULATION, DIVISION, DECAYS, FILMS)
    assert not more, f"the groups of modalcam/pipeline/compile.py must compile and list {sorted(more)}"


def test_tracking_the_bare_sample_needs_no_other_kernel():
    found = kernels(python(TRACK_BARE, NUMBA_DEBUG_CACHE="1"))
    assert "kernel.register_line" in found
    more = found - listed(LINES)
    assert not more, f"LINES of modalcam/pipeline/compile.py must compile and list {sorted(more)}"


@pytest.fixture(scope="module")
def two_processes(tmp_path_factory):
    """A cache, empty before, and the reports of two processes that compiled its kernels at the same time."""
    folder = tmp_path_factory.mktemp("kernels")
    variables = {"NUMBA_CACHE_DIR": str(folder), "NUMBA_DEBUG_CACHE": "1"}
    with ThreadPoolExecutor(2) as threads:
        return folder, list(threads.map(lambda _: python(FILM_KERNELS, **variables), range(2)))


def test_of_two_processes_at_once_one_compiles(two_processes):
    """From an empty cache; what each computes is the same, to the bit, and agrees with the C library."""
    _, reports = two_processes
    saved = [kernels(report, "saved to") for report in reports]
    assert sorted(map(bool, saved)) == [False, True], saved
    assert listed(FILMS) <= saved[0] | saved[1]
    new, cached = ([x for x in report.splitlines() if not x.startswith("[cache]")] for report in reports)
    assert new == cached, "the cached kernels round differently from the newly compiled ones"
    check_values(new[0].split(), before="2")


def check_values(words, *, before):
    assert words[:2] == [before, "0"]
    found = np.array(words[2:], dtype=float)
    exact = np.array([math.erf(0.1 * k) for k in range(-30, 31)])
    # the last two bits of 1, as its description says
    assert np.max(np.abs(found - exact)) <= 2**-51, "fast_erf differs from that of the C library"


@pytest.mark.slow  # in the gate: support.other_processors, whose caches are apart
def test_kernels_of_another_processor_are_not_used(two_processes, tmp_path):
    """In a cache that was copied, or is shared, each processor has its own."""
    shutil.copytree(two_processes[0], tmp_path, dirs_exist_ok=True)
    here = {"NUMBA_CACHE_DIR": str(tmp_path)}
    other = here | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    check_values(python(FILM_KERNELS, **other).split(), before="2")
    check_values(python(FILM_KERNELS, **here).split(), before="0")
    assert len(list(tmp_path.rglob("kernels.add_strip-*.nbi"))) == 1
    assert len(list(tmp_path.rglob("kernels.add_strip-*.nbc"))) == 2


def test_kernels_of_a_read_only_installation_are_kept_for_the_user(tmp_path):
    """The first command says how much it compiles and the next nothing, and another process computes with the same.

    A file in the place of each folder of compiled files: permissions do not bind root, who may run the tests.
    """
    for package in ("tracker", "modal_id", "sim", "modalcam"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in {path.parent for path in tmp_path.rglob("*.py")}:
        (folder / "__pycache__").touch()
    user = tmp_path / "user"
    variables = dict.fromkeys(("XDG_CACHE_HOME", "HOME"), str(user))
    variables |= {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    both = {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT / 'tests'}"}
    words = python(TWO_COMMANDS, **variables | both).split()
    n = len(FILMS.called)
    assert words == ["first", "begin", "True", str(n), *["advance"] * n, "next"]
    check_values(python(FILM_KERNELS, **variables).split(), before="0")
    assert list(user.rglob("kernels.add_strip-*.nbc"))


class Told(Progress):
    def __init__(self):
        self.lines = []

    def begin(self, stage, total):
        self.lines.append((stage, total))


def test_a_cluster_compiles_nothing_for_this_machine(monkeypatch):
    monkeypatch.setattr("modalcam.pipeline.compile.is_compiled", lambda _: False)

    def submit(*_):
        raise AssertionError

    told = Told()
    compile_kernels(WorkerPool(submit, None), told)
    assert not told.lines


@pytest.mark.slow
def test_identify_says_that_it_compiles_and_the_next_time_does_not(tmp_path):
    time_s = np.arange(400) / 200.0
    decay = np.exp(-0.5 * time_s) * np.cos(2.0 * np.pi * 11.0 * time_s)
    noise = 1e-3 * np.random.default_rng(3).standard_normal(time_s.size)
    table = tmp_path / "decay.csv"
    np.savetxt(table, np.column_stack([time_s, decay + noise]), delimiter=",", header="time_s,x", comments="")
    first, second = (identified(table, tmp_path / name, tmp_path / "cache") for name in ("first", "second"))
    count = len(DIVISION.called) + len(DECAYS.called)
    assert f"compiling, first run on this machine: computed {count}" in first
    assert "compiling" not in second
    modes = [(tmp_path / name / "modes.csv").read_bytes() for name in ("first", "second")]
    assert modes[0] == modes[1]


def identified(table, out, cache):
    """What `modalcam identify` says on standard error."""
    command = [sys.executable, "-m", "modalcam", "identify", table, "-o", out]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    return " ".join(done.stderr.split())
