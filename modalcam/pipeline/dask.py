"""Tasks on the workers of a Dask cluster: the same futures, limits and child processes as on one machine.

A Dask worker does not compute in its own process: each of its threads passes its tasks to a child process, as
`LocalExecutor` does on one machine, so that a recording that hangs or crashes its decoder ends only a child process and
not the worker. The scheduler gives the tasks of a lost worker to another.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import platform
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar
from uuid import uuid4

from modalcam.common import InputError, ModalcamError
from modalcam.pipeline.atomic import write_text
from modalcam.pipeline.pool import SINGLE_THREAD, Announce, Limits, LocalExecutor, WorkerPool
from modalcam.pipeline.provenance import code_sha256, versions
from modalcam.plugins import OUR_PACKAGES, load_plugins

if TYPE_CHECKING:
    from distributed import Client

Task = TypeVar("Task")
Result = TypeVar("Result")

# How long a scheduler may take to answer, and the first worker to appear.
_ANSWER_S = 30
_WORKERS_S = 120
_SHARED = "a cluster needs a file system that this machine and every worker access under the same path"


class IncompatibleWorkerError(ModalcamError):
    """A worker of the cluster would not give the results that this machine would."""


@dataclass(frozen=True)
class WorkerRequirements:
    """What a worker needs to give the results that this machine would.

    `token` is a file in the folder of the results, whose `text` distinguishes that folder from one of the same name on
    another disk; `folders` are those of the recordings; `plugins` are names with the SHA-256 of their source.
    """

    token: Path
    text: str
    folders: tuple[Path, ...]
    versions: tuple[tuple[str, str], ...]
    code_sha256: str
    plugins: tuple[tuple[str, str], ...] = ()


@contextmanager
def cluster_pool(
    address: str,
    limits: Limits,
    *,
    out: Path,
    folders: tuple[Path, ...],
    plugins: tuple[str, ...] = (),
    announce: Announce | None = None,
) -> Iterator[WorkerPool]:
    """Pool of the workers of the cluster at `address`, checked; on leaving, tasks not begun are dropped.

    `out`, which exists, and `folders` of the recordings are absolute paths. InputError if `dask.distributed` is not
    installed, or no scheduler or no worker answers; IncompatibleWorkerError if a worker has other versions or plugins,
    does not see the folders, or may not start processes.
    """
    try:
        import dask  # noqa: PLC0415 - an optional extra
        from distributed import Client, KilledWorker  # noqa: PLC0415
    except ImportError as error:
        msg = "--scheduler needs dask.distributed: pip install distributed"
        raise InputError(msg) from error
    # A recording's tracks are sent with its task; Dask would warn about the size of each.
    settings = {"distributed.admin.large-graph-warning-threshold": "1 TB"}
    requirements = _requirements(out, folders, plugins)
    died = (BrokenExecutor, KilledWorker)
    try:
        with dask.config.set(settings), _quiet(), _connected(Client, address) as client:
            for worker, problem in client.run(incompatibility, requirements).items():
                if problem:
                    msg = f"worker {worker}: {problem}"
                    raise IncompatibleWorkerError(msg)
            # Not "pure": an equal task that is submitted again runs again.
            executor = client.get_executor(pure=False)
            drop = partial(executor.shutdown, wait=False)
            submit = partial(executor.submit, on_worker, limits, requirements)
            try:
                yield WorkerPool(submit, limits, died=died, kill=drop, announce=announce)
            finally:
                drop()
                with suppress(OSError):  # if the scheduler is gone
                    client.run(release, requirements, limits)
    finally:
        requirements.token.unlink(missing_ok=True)


@contextmanager
def _connected(kind: type[Client], address: str) -> Iterator[Client]:
    try:
        client = kind(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        msg = f"--scheduler {address}: no Dask scheduler answers there ({error})"
        raise InputError(msg) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WORKERS_S)
        except TimeoutError as error:
            msg = (
                f"--scheduler {address}: no worker there after {_WORKERS_S} s; "
                f"start some with `dask worker {address} --no-nanny`"
            )
            raise InputError(msg) from error
        yield client


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's log off the terminal: a lost connection ends as an error or as a failure of a task."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


def _requirements(out: Path, folders: tuple[Path, ...], plugins: tuple[str, ...]) -> WorkerRequirements:
    text = uuid4().hex
    # Named as a partial file: a later run removes what a killed one left.
    token = out / f".tmp-{os.getpid()}-cluster-{text}"
    write_text(token, text)
    return WorkerRequirements(
        token, text, folders, versions(), code_sha256(*OUR_PACKAGES), load_plugins(plugins)
    )


def incompatibility(requirements: WorkerRequirements) -> str:
    """Why the process that calls this does not meet the requirements; empty if it does."""
    if multiprocessing.current_process().daemon:
        return (
            "may not start child processes; start it with `dask worker --no-nanny`, "
            "or with the environment DASK_DISTRIBUTED__WORKER__DAEMON=False"
        )
    if code_sha256(*OUR_PACKAGES) != requirements.code_sha256 or versions() != requirements.versions:
        own = dict(versions())
        differing = [
            f"{name} {own.get(name, '(none)')} instead of {version}"
            for name, version in requirements.versions
            if own.get(name) != version
        ]
        found = ", ".join(differing) or "another state of modalcam's code"
        return f"would not give the same bytes: it has {found}; install the same versions on every machine"
    try:
        plugins = dict(load_plugins(name for name, _ in requirements.plugins))
    except InputError as error:
        return str(error)
    for name, sha256 in requirements.plugins:
        if plugins[name] != sha256:
            return f"has another version of plugin {name}; install the same version on every machine"
    try:
        same = requirements.token.read_text("utf-8") == requirements.text
    except OSError:
        same = False
    if not same:
        return f"cannot read {requirements.token.parent}; {_SHARED}"
    for folder in requirements.folders:
        if not folder.is_dir():
            return f"cannot read {folder}; {_SHARED}"
    return ""


def on_worker(
    limits: Limits, requirements: WorkerRequirements, function: Callable[[Task], Result], task: Task
) -> Result:
    """Call the function in a child process of the worker that runs this."""
    problem = _incompatibility_once(requirements)
    if problem:
        # Workers may join at any time, unchecked.
        msg = f"worker on {platform.node()}: {problem}"
        raise IncompatibleWorkerError(msg)
    return _children(requirements, limits).submit(function, task).result()


def release(requirements: WorkerRequirements, limits: Limits) -> None:
    """Let the child processes of a run end after their current tasks."""
    threading.Thread(target=_children(requirements, limits).close, daemon=True).start()


_incompatibility_once = lru_cache(maxsize=8)(incompatibility)
_one_at_a_time = threading.Lock()


def _children(requirements: WorkerRequirements, limits: Limits) -> LocalExecutor:
    """Processes of this worker for one run."""
    with _one_at_a_time:
        return _new_children(requirements, limits)


@lru_cache(maxsize=8)
def _new_children(requirements: WorkerRequirements, limits: Limits) -> LocalExecutor:
    from distributed import get_worker  # noqa: PLC0415 - only workers come here

    # Permanently: threads of a worker start their children whenever they need them.
    os.environ.update(dict.fromkeys(SINGLE_THREAD, "1"))
    plugins = tuple(name for name, _ in requirements.plugins)
    return LocalExecutor(get_worker().state.nthreads, limits, plugins)
