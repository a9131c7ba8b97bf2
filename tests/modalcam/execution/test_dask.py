"""A run on a real Dask cluster: a scheduler and two workers, each a process of its own."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import pytest
from support.decay_clip import write_decay
from support.paths import ROOT
from support.worker_tasks import behave

from modalcam.commands import Options, run
from modalcam.errors import InputError
from modalcam.execution import dask as modalcam_cluster
from modalcam.execution.dask import IncompatibleWorkerError, WorkerRequirements, cluster_pool
from modalcam.execution.local import Limits
from modalcam.execution.pool import Progress, TaskFailure
from modalcam.storage.provenance import code_sha256, versions

distributed = pytest.importorskip("distributed", reason="the extra modalcam[cluster] is not installed")


@contextmanager
def process(module, *args):
    # A file system that all see at one path, and this working copy: what a cluster's users have to provide.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}
    running = subprocess.Popen(
        [sys.executable, "-m", module, *args],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield running
    finally:
        running.kill()
        running.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Address of a scheduler with two workers of one thread, and their processes by address."""
    folder = tmp_path_factory.mktemp("dask")
    contact = folder / "scheduler.json"
    common = ("--scheduler-file", str(contact), "--no-dashboard")
    with ExitStack() as stack:
        stack.enter_context(process("distributed.cli.dask_scheduler", "--port", "0", *common))
        worker = ("--no-nanny", "--nthreads", "1", "--local-directory", str(folder), *common)
        for _ in range(2):
            stack.enter_context(process("distributed.cli.dask_worker", *worker))
        with distributed.Client(scheduler_file=str(contact), timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
            yield client


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    """A recording of a dot that swings at mode 2 of the beam and comes to rest, and one that cannot be read."""
    folder = tmp_path_factory.mktemp("videos")
    write_decay(folder)
    (folder / "broken.mkv").write_bytes(b"not a video")
    return folder


@pytest.fixture
def address(cluster):
    return cluster.scheduler_info()["address"]


def contents(out):
    """Bytes of every file of a run but its lock and its notes on the files of the recordings, which are no results."""
    files = [p for p in sorted(out.rglob("*")) if p.is_file() and p.name not in ("lock", "inputs.json")]
    return {p.relative_to(out): p.read_bytes() for p in files}


def kill_a_busy_worker(client, pids, killed, over):
    while not over.is_set():
        for address, tasks in client.processing().items():
            if tasks and address in pids:
                os.kill(pids[address], signal.SIGKILL)
                killed.append(address)
                return
        over.wait(0.01)


def test_limits_hold_on_a_cluster_and_a_crash_costs_no_worker(cluster, address, tmp_path):
    workers = set(cluster.scheduler_info()["workers"])
    tasks = ["a", "hang", "die", f"die-once {tmp_path / 'died'}", "raise"]
    with cluster_pool(address, Limits(seconds=2.0), out=tmp_path, folders=()) as pool:
        fine, hung, died, tried_again, raised = pool.map(behave, tasks)
    assert fine == ("A", "1")
    assert isinstance(hung, TaskFailure)
    assert "did not finish within 2 s" in hung.reason
    assert isinstance(died, TaskFailure)
    assert "died, twice" in died.reason
    assert tried_again[0] == "DIE-ONCE"
    assert isinstance(raised, TaskFailure)
    assert raised.internal
    assert pool.internal_errors == 1
    assert set(cluster.scheduler_info()["workers"]) == workers
    assert [p.name for p in tmp_path.iterdir()] == ["died"]


def test_a_worker_that_does_not_see_the_folders_is_reported_before_the_work(address, tmp_path):
    elsewhere = tmp_path / "only-here"
    with (
        pytest.raises(
            IncompatibleWorkerError, match=r"worker tcp://.* does not see .*only-here; a cluster needs a file"
        ),
        cluster_pool(address, Limits(), out=tmp_path, folders=(elsewhere,)),
    ):
        pass


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"versions": (("modalcam", "0.0"),)}, r"modalcam .* instead of 0\.0"),
        ({"code_sha256": "0" * 64}, "another state of modalcam's code"),
        ({"text": "of another disk"}, "does not see"),
        (
            {"plugins": (("support.worker_tasks", "0" * 64),)},
            "another version of plugin support.worker_tasks",
        ),
        ({"plugins": (("absent_plugin", ""),)}, "plugin absent_plugin: cannot be imported"),
    ],
)
def test_a_worker_that_would_give_other_bytes_is_incompatible(cluster, tmp_path, change, words):
    token = tmp_path / "token"
    token.write_text("text")
    packages = ("tracker", "modal_id", "sim", "modalcam")
    fit = WorkerRequirements(token, "text", (tmp_path,), versions(), code_sha256(*packages))
    assert set(cluster.run(modalcam_cluster.incompatibility, fit).values()) == {""}
    # Workers that join later are checked by their first task.
    with pytest.raises(IncompatibleWorkerError, match=words):
        cluster.submit(modalcam_cluster.on_worker, Limits(), replace(fit, **change), behave, "a").result()


def test_a_worker_that_may_not_start_processes_is_incompatible(monkeypatch, tmp_path):
    class Daemonic:
        daemon = True

    monkeypatch.setattr("multiprocessing.current_process", Daemonic)
    requirements = WorkerRequirements(tmp_path / "token", "text", (), versions(), "")
    assert "dask worker --no-nanny" in modalcam_cluster.incompatibility(requirements)


def test_no_scheduler_is_an_error_that_says_where(monkeypatch, tmp_path):
    monkeypatch.setattr(modalcam_cluster, "_ANSWER_S", 0.2)
    with (
        pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no Dask scheduler answers"),
        cluster_pool("tcp://127.0.0.1:9", Limits(), out=tmp_path, folders=()),
    ):
        pass
    assert not list(tmp_path.iterdir())


def test_a_run_loses_a_worker_and_gives_the_same_bytes_as_here(
    cluster, address, videos, tmp_path, monkeypatch
):
    # Saved results come from the workers; what this process then writes of them is the same in either case.
    monkeypatch.setattr("modalcam.commands._write_files", lambda _, result, *__, **___: result)
    here = run(videos, Options(tmp_path / "here", jobs=1), Progress())
    broken, take = here.recordings
    assert broken.failure
    assert take.comparison
    pids = cluster.run(os.getpid)
    assert len(pids) == 2
    killed, over = [], threading.Event()
    watch = threading.Thread(target=kill_a_busy_worker, args=(cluster, pids, killed, over))
    watch.start()
    try:
        run(videos, Options(tmp_path / "there", scheduler=address), Progress())
    finally:
        over.set()
        watch.join()
    assert len(killed) == 1
    assert list(cluster.scheduler_info()["workers"]) == [w for w in pids if w not in killed]
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
