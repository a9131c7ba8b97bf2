"""Mutated files of every kind: each is read, flagged or refused, within the limits of modalcam's worker processes."""

import sys
from collections import Counter

import pytest
from kit.attacks import WRITERS, Outcome, attack, write_whole
from support.worker_tasks import InThisProcess

from modalcam.pipeline import Limits, pool

# A file is stopped after this long: it ends a hang, whatever else the machine does meanwhile.
HANG_S = 240.0
MOST_BYTES = 10**9
MANY = 80
# Fast: one file of every third kind; readers of films are attacked in tracker/video/test_contract.py, too.
FEW = tuple(WRITERS)[::3]


@pytest.fixture(scope="module")
def processes():
    """One process with modalcam's own limits, started again when it dies."""
    with pool.worker_pool(1, Limits(HANG_S, MOST_BYTES)) as started:
        yield started


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    # In this process, without a limit on time: the first run of all compiles.
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(pool, "LocalExecutor", InThisProcess)
        patched.setattr(sys, "argv", [])
        write_whole(folder)
    return folder


def attacked(processes, whole, kinds, seeds):
    """Exit codes of all commands; the assertion lists every file that was answered badly."""
    tasks = [(kind, seed, whole) for kind in kinds for seed in seeds]
    bad, codes = [], Counter()
    for (kind, seed, _), outcome in zip(tasks, processes.map(attack, tasks), strict=True):
        if not isinstance(outcome, Outcome):
            bad.append(f"{kind} {seed}: {outcome.reason}")
            continue
        codes.update(outcome.codes)
        bad += [f"{kind} {seed}: {problem}" for problem in outcome.problems]
        if outcome.peak_bytes > MOST_BYTES:
            bad.append(f"{kind} {seed}: {outcome.peak_bytes / 1e6:.0f} MB")
    assert not bad, "\n".join(bad)
    return codes


def test_a_few_mutated_files_are_read_flagged_or_refused(processes, whole):
    codes = attacked(processes, whole, FEW, range(1, 2))
    # Mutations that always, or never, made a file unreadable would show little.
    assert codes[0] > 0
    assert codes[2] + codes[3] + codes[4] > 0


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("kind", WRITERS)
def test_many_mutated_files_are_read_flagged_or_refused(processes, whole, kind):
    codes = attacked(processes, whole, [kind], range(100, 100 + MANY))
    assert codes[2] + codes[3] + codes[4] > 0, f"no {kind} file was refused: {codes}"
