"""Every code block of the documents is valid: commands parse, configurations are accepted, Python runs or compiles."""

import ast
import contextlib
import importlib
import io
import re
import runpy
import shlex
import subprocess
import sys
import tomllib

import numpy as np
import pytest
import typer
from kit.series import decay
from support.paths import APPS, COMMANDS_OF_APPS, ROOT

import modalcam as mc
from benchmarks.known_input_scenes import FREQUENCIES_HZ, record
from modal_id import ModeFlag
from modalcam.cli import app
from modalcam.common import ExitCode
from modalcam.config import ExperimentConfig
from tracker import REGISTRY

PACKAGES = ("tracker", "modal_id", "sim", "modalcam")
FOLDERS = sorted({path.parent for name in PACKAGES for path in (ROOT / name).rglob("*.py")})
READMES = [*(folder / "README.md" for folder in FOLDERS), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
DOCS = sorted([*(ROOT / "docs").rglob("*.md"), *READMES])
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
            if name != "docs/extending.md":  # options of plugins
                ExperimentConfig.model_validate(tree)
        elif language == "python":
            compile(text, name, "exec")
        elif language != "sh":
            assert NOT_CODE.match(language), f"{name}: a block in {language!r} is neither run nor output"
        known += 1
    assert known > 15


def test_python_of_the_guides_runs():
    """On the response to a random base motion, and on a mode of 128 Hz filmed at two rates."""
    one, printed = record("random", 11), io.StringIO()
    names = {"mc": mc, "t": one.time_s, "y": one.values, "base": one.base}
    for name, fps in (("slow", 250.0), ("fast", 400.0)):
        time_s, noise = np.arange(400) / fps, 0.01 * np.random.default_rng(1).standard_normal(400)
        names |= {f"t_{name}": time_s, f"y_{name}": decay(time_s, 128.0, 0.0025) + noise}
    with contextlib.redirect_stdout(printed):
        for name, language, text in blocks():
            if (name, language) == ("docs/howto.md", "python"):
                exec(compile(text, name, "exec"), names)  # noqa: S102 - our own guide
    assert abs(names["found"].modes[0].frequency_hz - FREQUENCIES_HZ[0]) < 0.01
    assert re.search(r"series 1: 128 Hz .* not 122 Hz", printed.getvalue())


def test_the_page_of_the_notebook_is_up_to_date(tmp_path):
    """Its words and code, and what its cells show, to the last digit, which another processor may change by one."""
    drawn, number = runpy.run_path(str(ROOT / "docs" / "notebook.py")), re.compile(r"\d+\.\d+")
    page, made = (ROOT / "docs" / "notebook.md").read_text(encoding="utf-8"), drawn["markdown"](tmp_path)
    assert all("".join(c["source"]) in page and not c.get("outputs") for c in drawn["cells"]())
    assert number.sub("", page) == number.sub("", made), "run python docs/notebook.py"
    for stated, found in zip(number.findall(page), number.findall(made), strict=True):
        assert float(stated) == pytest.approx(float(found), abs=1.5 * 0.1 ** len(stated.split(".")[1]))
    assert set(re.findall(r"notebook_\d\.png", page)) == {path.name for path in tmp_path.iterdir()}


def messages():
    """Texts of the sources, with … where a value is put in."""
    for path in (path for name in PACKAGES for path in (ROOT / name).rglob("*.py")):
        nodes = [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
        documentation = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if isinstance(node, ast.JoinedStr):
                yield "".join(part.value if isinstance(part, ast.Constant) else "…" for part in node.values)
            elif isinstance(node, ast.Constant) and id(node) not in documentation:
                yield re.sub(r"\{[^{}]*\}", "…", str(node.value))


def test_questions_quote_what_the_program_says():
    headings = re.findall(r"^### (.*)", (ROOT / "docs" / "faq.md").read_text(encoding="utf-8"), re.MULTILINE)
    quoted = {text for heading in headings for text in re.findall(r"`([^`]+)`", heading)}
    flags = {flag.name for flag in (*ModeFlag, *REGISTRY)}
    assert flags <= quoted, "a flag without an answer"
    said = "\n".join(messages())
    unsaid = [text for text in quoted - flags if text not in said]
    assert not unsaid, f"no source says {unsaid}"
    codes = {int(code) for heading in headings for code in re.findall(r"[Ee]xit code (\d+)", heading)}
    assert codes == {ExitCode.USAGE, ExitCode.NO_INPUT, ExitCode.PARTIAL}


@pytest.mark.skipif(not APPS, reason="modalcam/apps was deleted")
def test_commands_and_options_in_sentences_exist():
    commands = typer.main.get_command(app).commands
    parameters = [parameter for command in commands.values() for parameter in command.params]
    named = (name for one in parameters for name in (*one.opts, *one.secondary_opts))
    options = {"--help", "--no-nanny", *named}  # the second is of Dask's workers
    for path in (path for path in DOCS if path.parent.name != "studies"):  # theirs are of the benchmarks
        text = BLOCK.sub("", path.read_text(encoding="utf-8"))
        named = {name for name in re.findall(r"`modalcam ([a-z][\w-]*)[^`]*`", text) if name not in commands}
        named |= {name for name in re.findall(r"`(--[a-z][\w-]*)[^`]*`", text) if name not in options}
        assert not named, f"{path.relative_to(ROOT)}: no {', '.join(sorted(named))}"


@pytest.mark.parametrize("page", ["glossary", "cli", "architecture"][: None if APPS else 1])
def test_pages_made_of_the_sources_are_up_to_date(page):
    made = runpy.run_path(str(ROOT / "docs" / f"{page}.py"))["markdown"]()
    assert (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8") == made, f"run python docs/{page}.py"


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


def anchors(path):
    """Of the headings of a document, as GitHub and Sphinx name them."""
    headings = re.findall(r"^#+ (.*)", BLOCK.sub("", path.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_between_documents_lead_somewhere():
    for path in DOCS:
        for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([\w-]+))?\)", path.read_text("utf-8")):
            found = path.parent / target if target else path
            assert found.exists(), f"{path.relative_to(ROOT)}: no {target}"
            assert not anchor or anchor in anchors(found), f"{path}: no #{anchor} in {target}"


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
