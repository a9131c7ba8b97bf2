"""What packages, benchmarks, docs and tests may import of each other, beyond the order of folders in pyproject.toml."""

import ast
from functools import cache

import pytest
from support.paths import APPS, ROOT

# What each package may import of the others: prefixes of the names of the modules that define it.
RESULTS = ("results", "position_errors", "scale_change", "flags", "settings_base")
BASIC = ("tracker.arrays", "tracker.checks", "tracker.columns")
PACKAGES = {
    "tracker": (),
    "modal_id": (*BASIC, *(f"tracker.{name}" for name in RESULTS)),
    "sim": (*BASIC, "modal_id.results"),
    "modalcam": ("tracker", "modal_id", "sim"),
}
# Scripts beside the packages, and which of the other scripts they may import.
SCRIPTS = {"benchmarks": ("benchmarks",), "docs": ("docs",), "sample_videos": ()}
# Of these scripts, what tests may import: solutions that verify the simulation on the page and in the tests, and films,
# tracks and records made for both the benchmark and the tests.
SCENES = ("film_scenes", "line_scenes", "ambient_scenes", "known_input_scenes", "camera_motion")
SCENES += ("random_records", "converted_rates")
SHARED = ("docs.reference_solutions.", *(f"benchmarks.{name}." for name in SCENES))


@cache
def statements(path):
    """Imports of a file, which is parsed and searched once for all tests."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return tuple(node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))


@cache
def imported(path):
    """Full names of the modules and objects that a file imports."""
    names = []
    for node in statements(path):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        else:
            assert node.level == 0, f"{path}: relative import; write the full name"
            names += [defined(node.module, alias.name) for alias in node.names]
    return tuple(names)


@cache
def door(folder):
    """Names that a folder re-exports, each with the module that defines it."""
    stub = ROOT / folder.replace(".", "/") / "__init__.pyi"
    if not stub.is_file():
        return {}
    nodes = ast.walk(ast.parse(stub.read_text(encoding="utf-8")))
    found = [(n.module, a.name) for n in nodes if isinstance(n, ast.ImportFrom) for a in n.names]
    return {name: f"{folder}.{module}" if module else folder for module, name in found}


def defined(module, name):
    """Full name of what is imported from a module, or through the door of a folder."""
    return f"{door(module).get(name, module)}.{name}"


def past_the_door(importer, module):
    """Whether a module that belongs to another folder is imported by its own name.

    A folder's own files and those of the folders around it are imported by name, and those of `modalcam` itself, whose
    door is the public API.
    """
    path = ROOT / module.replace(".", "/")
    top = module.split(".")[0]
    if top not in PACKAGES or path.is_dir() or "." not in module:
        return False
    if not APPS and module.startswith("modalcam.apps."):
        return False
    folder = module.rpartition(".")[0]
    own = ".".join(importer.relative_to(ROOT).parent.parts)
    return folder != "modalcam" and not f"{own}.".startswith(f"{folder}.")


def files(folder):
    found = sorted((ROOT / folder).rglob("*.py"))
    assert found or folder in ("docs", "sample_videos"), f"{folder} holds no module"
    return found


def forbidden(package, name):
    """Whether a package must not import an object of another one."""
    top = name.split(".")[0]
    if top in ("tests", "support", "kit", *SCRIPTS):
        return True
    if top not in PACKAGES or top == package:
        return False
    return not any(name == allowed or name.startswith(allowed + ".") for allowed in PACKAGES[package])


def is_module(name):
    path = ROOT / name.replace(".", "/")
    return path.is_dir() or path.with_suffix(".py").is_file()


def through_a_door_around(importer, module):
    """Whether a file imports through the `__init__` of its own folder or of one around it, but for the version."""
    own = ".".join(importer.relative_to(ROOT).parent.parts)
    return f"{own}.".startswith(f"{module}.") and importer.name != "__init__.py"


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_earlier_packages(package):
    wrong = [f"{p}: {n}" for p in files(package) for n in imported(p) if forbidden(package, n)]
    assert not wrong, f"allowed are {PACKAGES[package]}; found " + "; ".join(wrong)


@pytest.mark.parametrize("package", PACKAGES)
def test_the_order_of_the_folders_cannot_be_passed_by(package):
    # lint-imports, which .ci/run calls, sees the folders that a file imports, but not what an `__init__` re-exports.
    wrong = [
        f"{path.relative_to(ROOT)}: {node.module}.{alias.name}"
        for path in files(package)
        for node in statements(path)
        if isinstance(node, ast.ImportFrom) and through_a_door_around(path, node.module)
        for alias in node.names
        if alias.name != "__version__" and not is_module(f"{node.module}.{alias.name}")
    ]
    assert not wrong, "import from the file, not from the folder around it: " + "; ".join(wrong)


@pytest.mark.parametrize("folder", [*PACKAGES, *SCRIPTS, "tests"])
def test_other_folders_are_entered_through_their_doors(folder):
    wrong = []
    for path in files(folder):
        nodes = [n for n in statements(path) if isinstance(n, ast.ImportFrom)]
        wrong += [
            f"{path.relative_to(ROOT)}: {node.module}.{alias.name}"
            for node in nodes
            for alias in node.names
            if past_the_door(path, node.module) and not alias.name.startswith("_")
        ]
    assert not wrong, "import from the folder, not from its file: " + "; ".join(wrong)


@pytest.mark.parametrize("folder", SCRIPTS)
def test_scripts_import_no_tests(folder):
    others = {"tests", "support", "kit", *SCRIPTS} - set(SCRIPTS[folder])
    wrong = [f"{p}: {n}" for p in files(folder) for n in imported(p) if n.split(".")[0] in others]
    assert not wrong, "; ".join(wrong)


def test_only_tests_of_benchmarks_import_benchmarks():
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in files("tests")
        for name in imported(path)
        if name.split(".")[0] in SCRIPTS
        and path.parent != ROOT / "tests" / "benchmarks"
        and not name.startswith(SHARED)
    ]
    assert not wrong, "; ".join(wrong)


def test_a_wrong_import_is_detected():
    assert forbidden("tracker", "modal_id.results.Onset")
    assert forbidden("modal_id", "tracker.follow")
    assert forbidden("sim", "modal_id.identify")
    assert forbidden("modalcam", "tests.support.paths")
    assert not forbidden("modal_id", "tracker.results.DisplacementSeries")
    assert not forbidden("modalcam", "sim.beam.properties")
    video = ROOT / "tracker/video/tiff.py"
    assert through_a_door_around(video, "tracker")
    assert through_a_door_around(video, "tracker.video")
    assert not through_a_door_around(video, "tracker.geometry")
