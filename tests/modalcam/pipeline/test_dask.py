"""A run on a real Dask cluster: a scheduler and two workers, each a separate process."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import pytest
from support.paths import ROOT
from support.worker_tasks import behave

from modalcam.commands import Options, run
from modalcam.common import InputError
from modalcam.pipeline import (
    IncompatibleWorkerError,
    Limits,
    Progress,
    TaskFailure,
    WorkerRequirements,
    cluster_pool,
    code_sha256,
    versions,
)
from modalcam.pipeline import dask as modalcam_cluster

distributed = pytest.importorskip("distributed", reason="the extra modalcam[cluster] is not installed")


@contextmanager
def process(module, *args):
    # As on a user's cluster, all processes use the same file system and the same copy of the code.
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
    """A client of a scheduler with two workers of one thread each."""
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


@pytest.fixture
def address(cluster):
    return cluster.scheduler_info()["address"]


def saved_results(out):
    return {path.name: path.read_bytes() for path in sorted((out / "state").glob("*.npz"))}


def kill_a_busy_worker(client, pids, killed, over):
    while not over.is_set():
        for address, tasks in client.processing().items():
            if tasks and address in pids:
                os.kill(pids[address], signal.SIGKILL)
                killed.append(address)
                return
        over.wait(0.01)


def test_limits_apply_on_a_cluster_and_a_crash_stops_no_worker(cluster, address, tmp_path):
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


def test_a_worker_without_access_to_the_folders_is_reported_first(address, tmp_path):
    local = tmp_path / "only-local"
    with (
        pytest.raises(
            IncompatibleWorkerError, match=r"worker tcp://.* cannot read .*only-local; a cluster needs a file"
        ),
        cluster_pool(address, Limits(), out=tmp_path, folders=(local,)),
    ):
        pass


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"versions": (("modalcam", "0.0"),)}, r"modalcam .* instead of 0\.0"),
        ({"code_sha256": "0" * 64}, "another state of modalcam's code"),
        ({"text": "of another disk"}, "cannot read"),
        (
            {"plugins": (("support.worker_tasks", "0" * 64),)},
            "another version of plugin support.worker_tasks",
        ),
        ({"plugins": (("absent_plugin", ""),)}, "plugin absent_plugin: cannot be imported"),
    ],
)
def test_a_worker_with_other_code_or_files_is_incompatible(cluster, tmp_path, change, words):
    token = tmp_path / "token"
    token.write_text("text")
    packages = ("tracker", "modal_id", "sim", "modalcam")
    fit = WorkerRequirements(token, "text", (tmp_path,), versions(), code_sha256(*packages))
    assert set(cluster.run(modalcam_cluster.incompatibility, fit).values()) == {""}
    # Workers that join later are checked by their first task.
    with pytest.raises(IncompatibleWorkerError, match=words):
        cluster.submit(modalcam_cluster.on_worker, Limits(), replace(fit, **change), behave, "a").result()


def test_a_worker_that_cannot_start_processes_is_incompatible(monkeypatch, tmp_path):
    class Daemonic:
        daemon = True

    monkeypatch.setattr("multiprocessing.current_process", Daemonic)
    requirements = WorkerRequirements(tmp_path / "token", "text", (), versions(), "")
    assert "dask worker --no-nanny" in modalcam_cluster.incompatibility(requirements)


def test_a_missing_scheduler_is_an_error_with_its_address(monkeypatch, tmp_path):
    monkeypatch.setattr(modalcam_cluster, "_ANSWER_S", 0.2)
    with (
        pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no Dask scheduler answers"),
        cluster_pool("tcp://127.0.0.1:9", Limits(), out=tmp_path, folders=()),
    ):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.slow  # in the fast suite: tasks of a run on a cluster, and one that kills its worker
def test_a_run_that_loses_a_worker_gives_the_same_bytes_as_a_local_run(
    cluster, address, decay_run, tmp_path, monkeypatch
):
    # Workers save the results; only these are compared, not the files that this process writes from them.
    monkeypatch.setattr("modalcam.commands._write_files", lambda _, result, *__, **___: result)
    pids = cluster.run(os.getpid)
    assert len(pids) == 2
    killed, over = [], threading.Event()
    watch = threading.Thread(target=kill_a_busy_worker, args=(cluster, pids, killed, over))
    watch.start()
    try:
        found = run(decay_run / "videos", Options(tmp_path, scheduler=address), Progress())
    finally:
        over.set()
        watch.join()
    assert len(killed) == 1
    assert list(cluster.scheduler_info()["workers"]) == [w for w in pids if w not in killed]
    assert found.recordings[0].comparison
    assert saved_results(tmp_path) == saved_results(decay_run / "out")
