"""Setup of all tests: kernels compiled before workers start, slowest files first, runs shared by workers."""

import gc
import os
import subprocess
import sys

import pytest
from filelock import FileLock
from hypothesis import settings
from support.paths import APPS, ROOT, SAMPLES

# One thread per process, set before NumPy loads BLAS: on busy cores, waiting threads take up to 30 times the CPU time
# for small matrices.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(variable, "1")

# Compiled modules are kept beside the kernels, also where the environment asks for none, as in many containers: the
# suite starts dozens of processes, and each would compile all packages again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Until all tests are collected: what is imported stays, and looking for cycles in it takes a fifth of the time.
gc.disable()

# Tests have no time limit per example, so that they do not fail on a busy machine.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# The slowest files, in this order. xdist distributes whole files (--dist loadfile): if one of these started
# last, the other workers would be idle.
LONGEST_FIRST = (
    "integration/test_sample_videos_run.py",
    "modalcam/test_commands.py",
    "modalcam/report/test_report_html.py",
    "modalcam/apps/studio/test_studio_browser.py",
    "tracker/test_accuracy.py",
    "modalcam/report/test_report_browser.py",
    "tracker/test_real_footage.py",
    "tracker/follow/test_look_alikes.py",
    "tracker/markers/test_detection.py",
    "modalcam/cli/test_cli.py",
    # After those before, for which the samples take time: it needs their run.
    "modalcam/pipeline/test_compile.py",
    "modalcam/pipeline/test_dask.py",
    "tracker/video/test_contract.py",
)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """One worker more than processors: tests wait for other processes, browsers and clocks, a quarter of the time."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return len(os.sched_getaffinity(0)) + 1 if hasattr(os, "sched_getaffinity") else None


def pytest_configure(config):
    """Compile the kernels once, before the workers start."""
    controller = not hasattr(config, "workerinput")
    if controller and getattr(config.option, "numprocesses", None):
        compile_kernels()


def pytest_collection_finish():
    """Collect cycles again, but not in what was imported and collected."""
    gc.freeze()
    gc.enable()


def unmeasured_environment():
    """Environment of a process whose coverage is not measured."""
    return {name: value for name, value in os.environ.items() if not name.startswith("COV")}


def packages_environment():
    """The same, for a process that imports modalcam and `support`."""
    return unmeasured_environment() | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}


def compile_kernels():
    """Run `support.compile_kernels`; a failure is reported by the tests."""
    command = [sys.executable, "-m", "support.compile_kernels"]
    subprocess.run(command, env=packages_environment(), check=False)


def pytest_collection_modifyitems(items):
    """Move the longest files to the front; all others keep their order."""
    folder = ROOT / "tests"
    for name in LONGEST_FIRST:
        assert (folder / name).is_file() or (not APPS and "/apps/" in name), (
            f"LONGEST_FIRST in tests/conftest.py names {name}, which does not exist"
        )
    ranks = {folder / name: rank for rank, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


@pytest.fixture
def modalcam(monkeypatch, capfd):
    """``modalcam(*arguments)``: exit code, standard output, and standard error with each run of blanks as one."""
    # most test files need no command line
    from modalcam import cli

    def call(*args):
        monkeypatch.setattr(sys, "argv", ["modalcam", *map(str, args)])
        with pytest.raises(SystemExit) as info:
            cli.main()
        out, err = capfd.readouterr()
        assert "\x1b" not in out + err
        return info.value.code or 0, out, " ".join(err.replace("│", " ").split())

    return call


@pytest.fixture
def in_process(monkeypatch):
    """Commands start no worker processes, each of which imports for seconds; for tests of what commands do."""
    # imports NumPy, which the controller of the workers does not need
    from support.worker_tasks import InThisProcess

    monkeypatch.setattr("modalcam.pipeline.pool.LocalExecutor", InThisProcess)


@pytest.fixture
def no_figures(monkeypatch):
    """Reports without figures, which take most of their time; for tests of their text or of other files."""
    monkeypatch.setattr("modalcam.report.figures.registry.FIGURES", {})


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory, request):
    """``shared_folder(name, fill)``: a folder that ``fill(folder)`` fills once for all workers; read it only."""
    base = tmp_path_factory.getbasetemp()
    if hasattr(request.config, "workerinput"):
        base = base.parent

    def get(name, fill):
        folder = base / "shared" / name
        folder.parent.mkdir(exist_ok=True)
        with FileLock(folder.with_suffix(".lock")):
            if not folder.with_suffix(".done").exists():
                folder.mkdir()
                fill(folder)
                folder.with_suffix(".done").touch()
        return folder

    return get


@pytest.fixture(scope="session")
def decay_run(shared_folder):
    """A finished run of the shortest recording that passes every stage: folders ``videos`` and ``out``."""
    # most test files need none of these modules
    from kit.films import write_decay
    from support.worker_tasks import InThisProcess

    from modalcam.commands import Options, run
    from modalcam.pipeline import Progress

    def fill(folder):
        write_decay(folder / "videos")
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("modalcam.pipeline.pool.LocalExecutor", InThisProcess)
            run(folder / "videos", Options(folder / "out"), Progress())

    return shared_folder("decay_run", fill)


@pytest.fixture(scope="session")
def samples_run(shared_folder):
    """The output folder of `modalcam paper sample_videos`, which does all that `modalcam run` does but for figures.

    ``kernels.txt`` beside it holds numba's report of the compiled kernels that it loaded or saved.
    """

    def fill(folder):
        name, page = ("paper", "paper.html") if APPS else ("run", "report.html")
        command = [sys.executable, "-m", "support.samples_command", name, SAMPLES, "-o", folder / "out"]
        # The shorter runs of other tests measure the coverage; it would double the time of this one.
        environment = packages_environment() | {"NUMBA_DEBUG_CACHE": "1"}
        given = {"cwd": ROOT, "env": environment, "capture_output": True, "text": True, "timeout": 840}
        done = subprocess.run(command, **given, check=False)
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        kernels = [line for line in lines if line.startswith("[cache]")]
        # Processes write at the same time: the ends of their lines may follow each other.
        assert [line for line in lines if line and line not in kernels] == [str(folder / "out" / page)]
        (folder / "kernels.txt").write_text("\n".join(kernels), encoding="utf-8")

    return shared_folder("samples_run", fill) / "out"
