"""The table of time and memory: what a program used, and the files that it reads."""

import numpy as np
import pytest

from benchmarks.limits import motion, used, write_film, write_table
from modalcam.inputs import read_table
from tracker.video import probe


def test_time_and_memory_are_those_of_the_largest_process_of_a_program():
    one = "x = bytearray(60 * 2**20); x[::4096] = bytes(len(x[::4096]))"
    nested = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {one!r}], check=True)"
    small, large = used(("-c", "pass"), "none", 0), used(("-c", nested), "nested", 1)
    # 60 MB that only the inner process holds; Python itself takes about 10 in either.
    assert large.peak_mb - small.peak_mb == pytest.approx(60.0, abs=8.0)
    assert large.cpu_s > 0.0
    with pytest.raises(RuntimeError, match="exit code 3"):
        used(("-c", "raise SystemExit(3)"), "fails", 0)


def test_table_and_film_hold_the_decay_of_the_stated_length(tmp_path):
    write_table(tmp_path / "a.csv", 50)
    write_film(tmp_path / "a.mkv", 12)
    table = read_table(tmp_path / "a.csv").columns
    time_s, values = motion(50)
    assert np.allclose(table["time_s"], time_s, atol=1e-9)
    assert np.allclose(table["y"], values, atol=0.06), "six standard deviations of the noise"
    assert probe(tmp_path / "a.mkv").packets == 12


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_table_of_a_million_rows_is_identified_in_half_a_gigabyte(tmp_path):
    """The reduced version, without a process, is `test_memory_is_linear_in_the_length_of_the_record`."""
    short, long = (identified(tmp_path, rows) for rows in (1000, 1_000_000))
    per_row = 2**20 * (long.peak_mb - short.peak_mb) / 1e6
    assert long.peak_mb < 500.0, (
        f"{long.peak_mb:.0f} MB, of which Python, its libraries and the figures take {short.peak_mb:.0f} MB and each "
        f"row {per_row:.0f} bytes; 150 bytes are 18 columns of numbers: times, values, weights, residual, copies"
    )
    # Seconds of a million rows are microseconds of one.
    per_row_us = long.cpu_s - short.cpu_s
    assert per_row_us < 150.0, (
        f"{per_row_us:.0f} microseconds of CPU time a row: 42 were measured, linear from a thousand rows on; a step "
        "that is quadratic in the rows would take a thousand times as much"
    )


def identified(folder, rows):
    table = folder / f"{rows}.csv"
    write_table(table, rows)
    return used(("-m", "modalcam", "identify", str(table), "-o", str(folder / f"{rows}")), "identify", rows)
