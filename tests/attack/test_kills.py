"""A run that is killed at any moment and started again ends with the bytes of one that was not disturbed."""

import os
import shutil
import signal
import sys
import time

import numpy as np
import pytest
from kit.attacks import content
from kit.films import EXPERIMENT, write_decay

from modalcam.commands import Options, run
from modalcam.pipeline import Progress

KILLS = 24


def results(out):
    """All files but the lock; temporary files, too, which nobody would remove."""
    return {name: data for name, data in content(out).items() if name != "state/lock"}


def differing(out, expected, *beside):
    """Names of files that are not as expected, without those named `beside`."""
    found = results(out)
    names = (found.keys() | expected.keys()).difference(beside)
    return sorted(name for name in names if found.get(name) != expected.get(name))


def forked(folder, out, kill_at=0):
    """Run in a fork of this process, killed when it opens a file of OUT to write, or renames one, for this time.

    What is on the disk changes at these moments only. Returns the exit code, and how many moments there were.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        seen = 0

        def count(event, args):
            nonlocal seen
            writes = event == "open" and isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR)
            if (writes or event == "os.rename") and str(args[0]).startswith(str(out)):
                seen += 1
                if seen == kill_at:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(count)
        code = 1
        try:
            run(folder, Options(out), Progress())
            code = 0
        finally:
            os.write(writer, str(seen).encode())
            os._exit(code)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        seen = pipe.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), int(seen or 0)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_runs_killed_at_moments_spread_over_the_run_end_with_the_same_bytes(tmp_path, in_process):
    folder = tmp_path / "videos"
    for name, seed in (("a", 1), ("b", 2)):
        write_decay(folder, name=name, seed=seed)
    # The simulation of the beam takes most of the time; the killed runs below have it.
    (folder / "experiment.toml").write_text(EXPERIMENT[: EXPERIMENT.index("[beam]")])
    time.sleep(2.1)  # recordings that have just changed are not remembered
    code, moments = forked(folder, tmp_path / "whole")
    assert code == 0
    expected = results(tmp_path / "whole")
    rng = np.random.default_rng(24)
    unequal = []
    for k in range(KILLS):
        out = tmp_path / f"out{k}"
        kill_at = 1 + int(moments * (k + rng.uniform()) / KILLS)
        assert forked(folder, out, kill_at)[0] == -signal.SIGKILL
        assert forked(folder, out)[0] == 0, f"the run after a kill at write {kill_at} of {moments} failed"
        unequal += [f"killed at write {kill_at} of {moments}: {name}" for name in differing(out, expected)]
        shutil.rmtree(out)
    assert not unequal, "\n".join(unequal)


@pytest.mark.parametrize(("missing", "number"), [("modes.npz", 4), ("outputs", 14)])
def test_a_run_killed_while_it_saves_or_writes_ends_with_the_same_bytes(
    decay_run, tmp_path, in_process, missing, number
):
    expected = results(decay_run / "out")
    # Elsewhere than the finished run, which other tests read; of the same name, which is in the results.
    out = tmp_path / "out"
    shutil.copytree(decay_run / "out", out)
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        is_state = path.parent.name == "state" and path.suffix == ".npz"
        if path.name.endswith(missing) if is_state else missing == "outputs" and path.parent == out:
            path.unlink()
    (out / "state" / "run.json").unlink()
    assert forked(decay_run / "videos", out, number)[0] == -signal.SIGKILL
    # Hashes are remembered of recordings only that had not just changed when the run began.
    remembered = "state/inputs.json"
    assert differing(out, expected, remembered), "the run had ended before it was killed"
    run(decay_run / "videos", Options(out), Progress())
    assert not differing(out, expected, remembered)
