"""docs/bad_inputs.md: every group has a row, and every test that it names exists."""

import re

from support.paths import APPS, ROOT

GROUPS = 47
ROWS = [line.split(" | ") for line in (ROOT / "docs" / "bad_inputs.md").read_text("utf-8").splitlines()]
NAMED = {
    int(row[0].strip("| ")): re.findall(r"`(\S+\.py)::(test_\w+)`", row[-1])
    for row in ROWS
    if row[0][2:3].isdigit()
}


def test_every_group_names_a_test():
    assert list(NAMED) == list(range(1, GROUPS + 1))
    assert [number for number, tests in NAMED.items() if not tests] == []


def test_every_test_named_exists():
    named = [(file, name) for tests in NAMED.values() for file, name in tests if APPS or "/apps/" not in file]
    absent = [
        f"{file}::{name}"
        for file, name in named
        if not (ROOT / "tests" / file).is_file()
        or f"\ndef {name}(" not in (ROOT / "tests" / file).read_text("utf-8")
    ]
    assert absent == []
