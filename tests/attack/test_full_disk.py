"""A run on a medium that is full, of five sizes: one line, and the next run is right."""

import shutil
import subprocess
import sys

import pytest
from kit.attacks import content

# The folder is a file system of its own in a name space of the test's; then it grows, and the run is repeated.
SCRIPT = """
mount -t tmpfs -o size=$1 tmpfs "$2" || exit 99
"$4" -m modalcam run "$3" -o "$2/out" --jobs 1 2>"$5/first.txt" >/dev/null; first=$?
mount -o remount,size=200m "$2"
"$4" -m modalcam run "$3" -o "$2/out" --jobs 1 2>"$5/second.txt" >/dev/null; second=$?
cp -r "$2/out" "$5/out"
echo "$first $second"
"""


def unshared(*command):
    unshare = shutil.which("unshare") or pytest.skip("this system has no unshare")
    return subprocess.run(
        [unshare, "-rm", *map(str, command)], capture_output=True, text=True, timeout=900, check=False
    )


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("size_kb", [4, 100, 1024, 3072, 10_240])
def test_a_run_on_a_full_medium_says_so_and_the_next_is_right(decay_run, tmp_path, size_kb):
    if unshared("true").returncode:
        pytest.skip("this system has no name spaces for users")
    medium, copy = tmp_path / "medium", tmp_path / "copy"
    medium.mkdir()
    copy.mkdir()
    done = unshared(
        "sh", "-c", SCRIPT, "sh", f"{size_kb}k", medium, decay_run / "videos", sys.executable, copy
    )
    first, second = map(int, done.stdout.split())
    said = " ".join((copy / "first.txt").read_text().split())
    assert "Traceback" not in said
    assert first == 0 or (first == 2 and "No space left on device" in said), said[-500:]
    # All of it fits where the run ended well.
    needed_kb = sum(4 * -(-len(data) // 4096) for data in content(copy / "out").values())
    assert first == 2 or needed_kb <= size_kb, f"ended well on {size_kb} kB, its files take {needed_kb} kB"
    assert second == 0, (copy / "second.txt").read_text()[-500:]
    found, expected = content(copy / "out"), content(decay_run / "out")
    kept = [name for name in expected if not name.startswith("state/")]
    assert {name: found.get(name) == expected[name] for name in kept} == dict.fromkeys(kept, True)
