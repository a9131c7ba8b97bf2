"""Every code block of the documents is valid: commands parse, configurations are accepted, Python compiles."""

import importlib
import re
import runpy
import shlex
import subprocess
import sys
import tomllib

import pytest
import typer
from support.paths import APPS, COMMANDS_OF_APPS, ROOT

from modalcam.cli import app
from modalcam.config import ExperimentConfig

PACKAGES = ("tracker", "modal_id", "sim", "modalcam")
FOLDERS = sorted({path.parent for name in PACKAGES for path in (ROOT / name).rglob("*.py")})
DOCS = sorted(
    [
        *(ROOT / "docs").rglob("*.md"),
        *(folder / "README.md" for folder in FOLDERS),
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
    ]
)
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
# Directives of the documentation, sources that are quoted, and what a command prints.
NOT_CODE = re.compile(r"\{[a-z-]+\}|text|bibtex|jinja|$")


def blocks():
    for path in DOCS:
        for language, text in BLOCK.findall(path.read_text(encoding="utf-8")):
            yield path.relative_to(ROOT).as_posix(), language.strip(), text


def commands(language):
    """Each line of the shell blocks that calls modalcam, without comments and what precedes it."""
    for name, own, text in blocks():
        if own == language:
            joined = text.replace("\\\n", " ")
            for line in joined.splitlines():
                for part in line.split("&&"):
                    words = shlex.split(part, comments=True)
                    if words and words[0].rpartition("/")[2] == "modalcam" and there(words[1]):
                        yield pytest.param(words[1:], id=f"{name}: {' '.join(words[1:])}"[:80])


def there(command):
    return APPS or command not in COMMANDS_OF_APPS


def parse(words):
    group = typer.main.get_command(app)
    command = group.commands[words[0]]
    values = list(words[1:])
    context = command.make_context(words[0], values, resilient_parsing=False)
    context.close()


@pytest.mark.parametrize("words", list(commands("sh")))
def test_commands_of_the_documents_parse(words):
    if words[0].startswith("--"):
        assert words == ["--help"]
    else:
        parse(words)


@pytest.mark.parametrize("words", [["run"], ["run", "videos", "--frames", "3"], ["verify"]])
def test_the_check_refuses_a_wrong_command(words):
    with pytest.raises(Exception, match=r"Missing|No such option"):
        parse(words)


def test_other_blocks_are_valid():
    known = 0
    for name, language, text in blocks():
        if language == "toml":
            tree = tomllib.loads(text)
            if name in ("README.md", "docs/tutorial.md"):
                ExperimentConfig.model_validate(tree)
        elif language == "python":
            compile(text, name, "exec")
        elif language != "sh":
            assert NOT_CODE.match(language), (
                f"{name}: a block in {language!r} is neither run nor named as output"
            )
        known += 1
    assert known > 15


@pytest.mark.skipif(not APPS, reason="modalcam/apps was deleted")
def test_the_reference_of_commands_is_up_to_date():
    made = runpy.run_path(str(ROOT / "docs" / "cli.py"))["markdown"]()
    assert (ROOT / "docs" / "cli.md").read_text(encoding="utf-8") == made, "run python docs/cli.py"


@pytest.mark.skipif(not APPS, reason="modalcam/apps was deleted")
def test_the_table_of_folders_is_up_to_date():
    made = runpy.run_path(str(ROOT / "docs" / "architecture.py"))["markdown"]()
    assert (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8") == made, (
        "run python docs/architecture.py"
    )


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/architecture.md", "docs/theory.md"])
def test_files_that_a_document_names_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    named = re.findall(rf"`((?:{'|'.join(PACKAGES)}|benchmarks|tests|docs)/[\w/.]*)`", text)
    missing = [n for n in named if not (ROOT / n).exists() and (APPS or "/apps" not in n)]
    assert not missing, f"{page} names {', '.join(missing)}"


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.relative_to(ROOT).as_posix())
def test_entry_points_in_the_readme_of_a_folder_are_public(folder):
    public = dir(importlib.import_module(".".join(folder.relative_to(ROOT).parts)))
    paragraphs = (folder / "README.md").read_text(encoding="utf-8").split("\n\n")
    named = [n for p in paragraphs if p.startswith("Entry points:") for n in re.findall(r"`(\w+)`", p)]
    missing = [name for name in named if name not in public]
    assert not missing, f"{folder.name} has no {', '.join(missing)}"


def test_links_between_documents_lead_somewhere():
    for path in DOCS:
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[\w-]+)?\)", path.read_text(encoding="utf-8")):
            assert (path.parent / target).exists(), f"{path.relative_to(ROOT)}: no {target}"


@pytest.mark.slow
def test_the_documentation_builds_without_warnings(tmp_path):
    """.ci/run builds it, too."""
    pytest.importorskip("sphinx")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "tutorial.html").exists()


def test_documents_quote_the_measured_coverage():
    """The tables are made by benchmarks; a new measurement changes them, not the sentences that quote them."""
    drawn = runpy.run_path(str(ROOT / "docs" / "validation.py"))
    every, films = drawn["series"]()[-1], drawn["films"]()
    number, frequency, damping = (
        sum(getattr(film, name) for film in films) for name in ("records", "frequency", "damping")
    )
    series_damping, series_frequency = (
        f"{100.0 * count / every.records:.1f} %" for count in (every.damping, every.frequency)
    )
    readme, verdicts = (
        " ".join((ROOT / name).read_text(encoding="utf-8").split())
        for name in ("README.md", "docs/validation.md")
    )
    assert (
        f"the true damping ratio in {series_damping} of {every.records} simulated records and in {damping} of "
        f"{number} rendered films, lossless, MJPG or H.264, and the true frequency in {series_frequency} "
        f"and in {frequency}."
    ) in readme
    assert (
        f"damping ratio in {series_damping} of {every.records} simulated series, frequency in {series_frequency} "
    ) in verdicts
    assert f"damping ratio in {damping} of {number}, frequency in {frequency} " in verdicts


def test_the_figure_of_the_validation_shows_the_tables(tmp_path):
    """A drawn point is the name of a study with its number of records; another matplotlib draws other bytes."""
    drawn = runpy.run_path(str(ROOT / "docs" / "validation.py"))
    drawn["plot"](tmp_path / "made.svg")
    committed, made = (
        re.findall(r"<text[^>]*>([^<]+)</text>", path.read_text(encoding="utf-8"))
        for path in (ROOT / "docs" / "validation.svg", tmp_path / "made.svg")
    )
    assert committed == made, "run python docs/validation.py"
