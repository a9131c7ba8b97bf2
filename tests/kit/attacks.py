"""Mutated files of every kind that modalcam reads, each given to the commands that read it, in a process with limits.

A file follows from its kind and a seed: after `write_whole(folder)`, `attack(("gif", 17, folder))` repeats one.
"""

import contextlib
import io
import json
import os
import re
import resource
import shutil
import sys
import tempfile
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.paths import APPS
from support.worker_tasks import InThisProcess

from kit import camera_files, films
from kit.beams import experiment
from kit.mutations import mutated
from kit.series import decay
from modalcam import cli
from modalcam.pipeline import pool

# A refusal may list what was expected, for instance the endings of recordings.
LONGEST_REFUSAL = 1500
FORBIDDEN = ("Traceback", "internal error", "Warning: ", "\x1b")
# Every so many files of a kind pass all stages of a run, the others those that read the file.
WHOLE_RUN_EVERY = 16
FRAMES = 24
QUICK = '[camera]\nfps = 100\nexposure_s = 1e-4\n[markers]\nkind = "blob"\n'
CONFIGURATION = experiment(
    "[camera]\nfps = 100.0\nmm_per_px = 1.0\nexposure_s = 1e-3\n"
    '[markers]\nkind = "blob"\nsize_mm = 12.0\npositions_mm = [490.0]\n',
    '[plan]\nmodes = [1, 2]\n[[recordings]]\nfile = "take.avi"\nmode = 2\nonset_s = 0.25\n',
    elements=6,
    point_masses="[{ position_mm = 440.0, mass_g = 0.4 }]",
)


@cache
def images():
    """The first frames of the decay."""
    return films.decay_images(FRAMES)


def decay_table():
    """Times and displacement of a decay."""
    time_s = np.arange(300) / 100.0
    noise = 0.01 * np.random.default_rng(1).standard_normal(time_s.size)
    return time_s, decay(time_s, 10.2, 0.01, phase=0.0) + noise


def write_csv(path):
    np.savetxt(path, np.column_stack(decay_table()), "%.6g", ",", header="time_s,y", comments="")


def write_uff(path, binary=0):
    pyuff = pytest.importorskip("pyuff", reason="the extra modalcam[uff] is not installed")
    time_s, values = decay_table()
    codes = {"func_type": 1, "rsp_node": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "abscissa_spacing": 1}
    codes |= dict.fromkeys(("orddenom_spec_data_type", "z_axis_spec_data_type"), 0)
    codes |= {"abscissa_spec_data_type": 17, "ordinate_spec_data_type": 8, "ordinate_axis_units_lab": "mm"}
    data = pyuff.prepare_58(binary=binary, x=time_s, data=values, **codes)
    with warnings.catch_warnings():
        # pyuff opens a binary file a second time and does not close it.
        warnings.simplefilter("ignore", ResourceWarning)
        pyuff.UFF(str(path)).write_sets([data], "add")


def write_lvm(path):
    time_s, values = decay_table()
    head = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tOne\n"
    second = "***End_of_Header***\t\n\nChannels\t1\nX_Dimension\tTime\nX0\t0.0\nDelta_X\t0.01\n"
    rows = "".join(f"{t:.6g}\t{y:.6g}\n" for t, y in zip(time_s, values, strict=True))
    path.write_text(f"{head}{second}***End_of_Header***\t\t\nX_Value\ty\tComment\n{rows}")


def write_tdms(path):
    nptdms = pytest.importorskip("nptdms", reason="the extra modalcam[tdms] is not installed")
    _, values = decay_table()
    clock = {"wf_increment": 0.01, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("take", "y", values, clock)])


def write_hdf5(path):
    h5py = pytest.importorskip("h5py", reason="the extra modalcam[netcdf] is not installed")
    with h5py.File(path, "w") as file:
        for name, values in zip(("time", "y"), decay_table(), strict=True):
            file[name] = values


def write_xlsx(path):
    pytest.importorskip("openpyxl", reason="the extra modalcam[xlsx] is not installed")
    pd.DataFrame(dict(zip(("time_s", "y"), decay_table(), strict=True))).to_excel(path, index=False)


WRITERS = {
    "avi": lambda d: films.write(d / "take.avi", images()),
    "mp4": lambda d: films.write(d / "take.mp4", images(), codec="libx264"),
    "mkv": lambda d: films.write(d / "take.mkv", images(), codec="ffv1"),
    "mov": lambda d: films.write(d / "take.mov", images(), codec="mpeg4"),
    "gif": lambda d: camera_files.write_gif(d / "take.gif", images()),
    "tiff": lambda d: camera_files.write_stack(d / "take.tif", images()),
    "cih": lambda d: camera_files.write_photron(d / "take.cih", images(), bits=8),
    "cihx": lambda d: camera_files.write_photron(d / "take.cihx", images(), bits=8),
    "cine": lambda d: camera_files.write_cine(d / "take.cine", images(), bits=8),
    "toml": lambda d: (d / "experiment.toml").write_text(CONFIGURATION),
    "csv": lambda d: write_csv(d / "take.csv"),
    "uff": lambda d: write_uff(d / "take.uff"),
    "binary uff": lambda d: write_uff(d / "take.uff", binary=1),
    "lvm": lambda d: write_lvm(d / "take.lvm"),
    "tdms": lambda d: write_tdms(d / "take.tdms"),
    "h5": lambda d: write_hdf5(d / "take.h5"),
    "xlsx": lambda d: write_xlsx(d / "take.xlsx"),
    "npy": lambda d: np.save(d / "take.npy", np.column_stack(decay_table())),
    "state": lambda d: write_csv(d / "take.csv"),
}
TEXTS = ("toml", "csv", "uff", "lvm", "cih")
IDENTIFIED = ("csv", "uff", "binary uff", "lvm", "tdms", "h5", "xlsx", "npy")


@dataclass(frozen=True)
class Outcome:
    """Exit codes of the commands that were given the file, what was wrong, and the peak memory of the process."""

    codes: tuple[int, ...]
    problems: tuple[str, ...]
    peak_bytes: int


@contextlib.contextmanager
def captured():
    """Everything that is written to the two outputs meanwhile, also by libraries that are not Python's."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        kept = [os.dup(1), os.dup(2)]
        texts = []
        try:
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            with (
                contextlib.redirect_stdout(
                    io.TextIOWrapper(open(1, "wb", closefd=False), write_through=True)
                ),
                contextlib.redirect_stderr(
                    io.TextIOWrapper(open(2, "wb", closefd=False), write_through=True)
                ),
            ):
                yield texts
        finally:
            for number, duplicate in zip((1, 2), kept, strict=True):
                os.dup2(duplicate, number)
                os.close(duplicate)
            for file in (out, err):
                file.seek(0)
                texts.append(file.read().decode("utf-8", "replace"))


def command(*args):
    """Run a command of modalcam; returns its exit code and what it should not have said or done.

    Raises what would end in a traceback.
    """
    sys.argv = ["modalcam", *map(str, args)]
    with captured() as texts, pytest.raises(SystemExit) as end:
        cli.main()
    out, err = texts
    code = int(end.value.code or 0)
    problems = [repr(word) for word in FORBIDDEN if word in out + err]
    if code not in (0, 2, 3, 4):
        problems.append(f"exit code {code}: {err[-300:]}")
    if code in (2, 3) and not err.strip():
        problems.append("refused without a word")
    if code == 2 and len(err) > LONGEST_REFUSAL:
        problems.append(f"a refusal of {len(err)} characters: {err[:100]} ... {err[-100:]}")
    return code, [f"modalcam {args[0]}: {problem}" for problem in problems]


def content(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def damage(path, kind, rng):
    """Mutate a file, of saved results also the text inside the archive, whose check sum is right again."""
    if path.suffix != ".npz" or rng.integers(2):
        path.write_bytes(mutated(path.read_bytes(), rng, text=kind in TEXTS or path.suffix == ".json"))
        return
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = sorted(members)[int(rng.integers(len(members)))]
    members[name] = mutated(members[name], rng, text=name == "tree.npy")
    with zipfile.ZipFile(path, "w") as archive:
        for each, data in members.items():
            archive.writestr(each, data)


def attack(task):
    """Mutate one file of a kind by a seed and give it to the commands that read it."""
    kind, seed, whole = task
    pool.LocalExecutor = InThisProcess
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "inputs"
        shutil.copytree(Path(whole) / kind, folder)
        out = folder.parent / "out"
        if kind == "state":
            (folder / "out").rename(out)
        files = sorted(
            p for p in (out if kind == "state" else folder).rglob("*") if p.is_file() and p.name != "lock"
        )
        if kind == "toml":
            files = [folder / "experiment.toml"]
        damage(files[int(rng.integers(len(files)))], kind, rng)
        before = content(folder)
        calls = list(commands_for(kind, folder, out, Path(whole), whole_run=seed % WHOLE_RUN_EVERY == 0))
        results = [command(*call) for call in calls]
        problems = [problem for _, found in results for problem in found]
        if content(folder) != before:
            problems.append("the inputs were changed")
        problems += written_badly(out, Path(whole) / kind, kind, results)
    return Outcome(tuple(code for code, _ in results), tuple(problems), peak_memory())


def peak_memory():
    """Bytes. On Linux the peak in `getrusage` begins with that of the process that started this one."""
    status = Path("/proc/self/status")
    if not status.exists():
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status.read_text())[1])


def commands_for(kind, folder, out, whole, *, whole_run):
    """Arguments of the commands that read a file of this kind."""
    if kind == "toml":
        yield "check-config", folder / "experiment.toml"
        if APPS:
            yield "plan", folder / "experiment.toml"
        if whole_run:
            yield "run", folder, "-o", out, "--jobs", 1
    elif kind == "state":
        yield "report", out
        yield "identify", folder / "take.csv", "-o", out
        yield "report", out
    elif kind in IDENTIFIED:
        yield "identify", next(folder.iterdir()), "-o", out
    else:
        yield "probe", folder
        # Only every sixteenth file is tried with every kind of marker and all stages: that takes most of the time.
        quick = ("track", folder, "--config", whole / "quick.toml")
        call = ("run", folder, "--fps", 100) if whole_run else quick
        yield *call, "-o", out, "--jobs", 1


def written_badly(out, whole, kind, results):
    """What is wrong with OUT: internal errors, values that are no numbers, results that differ from intact ones."""
    summary = out / "summary.json"
    if not summary.exists():
        return []
    text = summary.read_text("utf-8")
    problems = ["internal error in the summary"] if "internal error" in text else []
    json.loads(text, parse_constant=lambda name: problems.append(f"{name} in the summary"))
    if re.search(r"\b(?:nan|inf)\b", (out / "report.html").read_text("utf-8")):
        problems.append("nan or inf in the report")
    codes = [code for code, _ in results]
    if kind == "state" and codes[-2:] == [0, 0]:
        expected = (whole / "out" / "modes.csv").read_bytes()
        if (out / "modes.csv").read_bytes() != expected:
            problems.append("modes.csv differs from that of an intact run")
    return problems


def write_whole(folder):
    """Intact files of every kind, each in a folder of its own; with the results of an identification."""
    for kind, write in WRITERS.items():
        (folder / kind).mkdir(parents=True)
        write(folder / kind)
    (folder / "quick.toml").write_text(QUICK)
    (folder / "toml" / "take.avi").write_bytes((folder / "avi" / "take.avi").read_bytes())
    code, problems = command("identify", folder / "state" / "take.csv", "-o", folder / "state" / "out")
    assert (code, problems) == (0, []), problems
