"""Every code block of the documents is valid: commands parse, configurations are accepted, Python compiles."""

import re
import runpy
import shlex
import subprocess
import sys
import tomllib

import pytest
import typer
from support.paths import ROOT

from modalcam.cli import app
from modalcam.config import ExperimentConfig

DOCS = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
# Directives of the documentation, sources that are quoted, and what a command prints.
NOT_CODE = re.compile(r"\{[a-z-]+\}|text|bibtex|$")


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
                    if words and words[0].rpartition("/")[2] == "modalcam":
                        yield pytest.param(words[1:], id=f"{name}: {' '.join(words[1:])}"[:80])


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


def test_the_reference_of_commands_is_up_to_date():
    made = runpy.run_path(str(ROOT / "docs" / "cli.py"))["markdown"]()
    assert (ROOT / "docs" / "cli.md").read_text(encoding="utf-8") == made, "run python docs/cli.py"


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


def test_the_readme_quotes_the_measured_coverage():
    """The tables are made by benchmarks; a new measurement changes them, not the sentence that quotes them."""

    def row(name, *first):
        lines = (ROOT / "docs" / name).read_text(encoding="utf-8").splitlines()
        cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
        return next(cell for cell in cells if tuple(cell[: len(first)]) == first)

    records = row("coverage.md", "every case", "all")
    films = [row("films.md", codec, "all", "", "") for codec in ("lossless", "MJPG", "H.264")]
    number, frequency, damping = (sum(int(film[k]) for film in films) for k in (4, 7, 9))
    expected = (
        f"the true damping ratio in {records[7]} % of [{records[2]} simulated records](docs/coverage.md) "
        f"and in {damping} of [{number} rendered films](docs/films.md), "
        f"lossless, MJPG or H.264, and the true frequency in {records[4]} % and in {frequency}."
    )
    assert expected in " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
