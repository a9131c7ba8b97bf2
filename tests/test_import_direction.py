"""The rooms of the design: tracker -> modal_id -> sim -> modalcam, one way."""

import ast

import pytest
from support.paths import ROOT

ROOMS = ("tracker", "modal_id", "sim", "modalcam")
# What a room may import of ours: prefixes of module names outside itself.
ALLOWED = {
    "tracker": (),
    "modal_id": ("tracker.results", "tracker.arrays", "tracker.options"),
    "sim": ("modal_id.results", "tracker.arrays"),
    "modalcam": ("tracker", "modal_id", "sim"),
}


def imported_modules(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; rooms import by full name"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def forbidden(room, module):
    top = module.split(".")[0]
    if top in ("tests", "benchmarks"):
        return True
    if top not in ROOMS or top == room:
        return False
    return not any(
        module == a or module.startswith(a + ".") or a.startswith(module + ".") for a in ALLOWED[room]
    )


@pytest.mark.parametrize("room", ROOMS)
def test_room_imports_only_what_lies_before_it(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert files, f"room {room} is empty"
    bad = [
        f"{path.relative_to(ROOT)} imports {module}"
        for path in files
        for module in imported_modules(path)
        if forbidden(room, module)
    ]
    assert not bad, f"the import direction of the rooms is {ALLOWED}: " + "; ".join(bad)


def test_the_check_sees_a_wrong_import():
    assert forbidden("tracker", "modal_id.results")
    assert forbidden("modal_id", "tracker.follow")
    assert forbidden("sim", "modal_id.identify")
    assert not forbidden("modal_id", "tracker.results.DisplacementSeries")
    assert not forbidden("modalcam", "sim.beam.properties")
