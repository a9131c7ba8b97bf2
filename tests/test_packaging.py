"""What the files of the distribution promise: dependencies, changelog fragments, version, quick imports."""

import re
import runpy
import subprocess
import sys
import tomllib

import pytest
from support.paths import APPS, ROOT

from modalcam import __version__
from modalcam.plugins import load_apps
from modalcam.tables import markdown

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def lowest(requirements):
    """Name and lowest version of each requirement that states one."""
    found = (re.match(r"([\w.-]+)(?:\[\w+\])?>=([\d.]+)", text) for text in requirements)
    return {match[1].lower(): match[2] for match in found if match}


def test_the_oldest_dependencies_are_those_that_pyproject_states():
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    parts = [
        project["dependencies"],
        *(
            extras[name]
            for name in ("netcdf", "xarray", "tdms", "xlsx", "uff", "tiff", "cluster", "studio", "test")
        ),
    ]
    stated = lowest(text for part in parts for text in part)
    lines = (ROOT / ".ci" / "oldest.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    # the checkers run on the newest dependencies
    assert set(stated) - set(pinned) == {"codespell", "mypy", "ruff"}
    for name, version in pinned.items():
        if name in stated:
            assert (version + ".").startswith(stated[name] + "."), (
                f"{name}: pinned {version}, stated {stated[name]}"
            )


def test_the_conda_recipe_has_the_dependencies_of_pyproject():
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    there = dict(re.findall(r"^    - ([\w-]+) >=([\d.]+)$", recipe.partition("  run:")[2], re.MULTILINE))
    names = {"matplotlib": "matplotlib-base", "opencv-contrib-python-headless": "py-opencv"}
    stated = {names.get(name, name): v for name, v in lowest(PROJECT["project"]["dependencies"]).items()}
    # the last number is that of the wheel alone
    stated["py-opencv"] = stated["py-opencv"].rpartition(".")[0]
    assert there == stated | {"python": PROJECT["project"]["requires-python"].removeprefix(">=")}
    assert f'version: "{PROJECT["project"]["version"]}"' in recipe


@pytest.mark.skipif(not APPS, reason="the list has the commands and tables of the apps")
def test_nothing_public_is_lost():
    now = set(runpy.run_path(str(ROOT / "docs" / "public.py"))["public"]())
    promised = set((ROOT / "docs" / "public.txt").read_text(encoding="utf-8").splitlines())
    assert not promised - now, f"docs/stability.md, deprecation: {sorted(promised - now)}"
    demanded = {line for line in now - promised if line.endswith(", required)")}
    assert not {line for line in demanded if line.partition("(")[0] in promised}, "old calls would fail"


def test_messages_name_packages_that_an_extra_installs():
    """Those of an index: modalcam itself is on none."""
    extras = PROJECT["project"]["optional-dependencies"].values()
    known = {re.split(r"[\[>=]", text)[0] for extra in extras for text in extra} - {"modalcam"}
    sources = [p for name in ("tracker", "modal_id", "sim", "modalcam") for p in (ROOT / name).rglob("*.py")]
    messages = [re.findall(r"pip install ([\w .\[\]'-]+)", path.read_text("utf-8")) for path in sources]
    named = {name for found in messages for text in found for name in text.split()}
    needed = {"pyuff", *(["nicegui", "tomlkit"] if APPS else [])}
    assert needed <= named <= known, f"in no extra: {sorted(named - known)}"


def test_fragments_have_a_type_that_towncrier_knows():
    types = "|".join(entry["directory"] for entry in PROJECT["tool"]["towncrier"]["type"])
    names = [path.name for path in (ROOT / "changes").iterdir() if path.name != "README.md"]
    wrong = [name for name in names if not re.fullmatch(rf"(\+[a-z0-9-]+|\d+)\.({types})\.md", name)]
    assert not wrong, f"see changes/README.md: {wrong}"


@pytest.mark.skipif(not APPS, reason="the page has the tables of the apps")
def test_the_columns_of_the_tables_are_up_to_date():
    load_apps("plugin")
    page = (ROOT / "docs" / "columns.md").read_text(encoding="utf-8")
    assert page == markdown(), "run python docs/columns.py"


def test_the_version_is_the_same_everywhere():
    assert PROJECT["project"]["version"] == __version__
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("tracker.settings, modal_id.settings", "cv2 scipy numba pandas"),
        ("modalcam", "numpy scipy cv2 numba pandas av"),
        ("modalcam.cli", "numpy pydantic cv2 pandas scipy numba matplotlib av"),
        # `modalcam report` whose figures are kept
        (
            "modalcam.report.build, modalcam.tables.writers, modalcam.pipeline.all_stages",
            "matplotlib pandas scipy.optimize skimage.measure._regionprops",
        ),
    ],
)
def test_an_import_loads_no_heavy_library(modules, heavy):
    code = f"import sys, {modules}; print(*{set(heavy.split())} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "", "it must be loaded when it is used"
