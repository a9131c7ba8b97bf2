"""Every option named in a message, a flag or the report exists in the configuration or command line."""

import ast
import re
from typing import get_args

import typer
from pydantic import BaseModel
from support.paths import ROOT

from modalcam.cli import app
from modalcam.config import ExperimentConfig

ADVICE = re.compile(
    r"\b(?:give|set|raise|lower|increase|reduce|decrease|choose|use|add|mark)\b[^.;]*", re.IGNORECASE
)
# Command-line options, sections of the configuration, and keys, which have a unit or several words.
NAMED = re.compile(r"--[a-z][a-z-]+|\[[a-z]+(?:\.[a-z]+)?\]|\b[a-z]+(?:_[a-z0-9]+)+\b")


def models_in(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from models_in(argument)


def configured(model):
    """Keys and sections of a configuration model."""
    for name, field in model.model_fields.items():
        key = field.alias or name
        yield key
        for part in models_in(field.annotation):
            yield f"[{key}]"
            for inner in configured(part):
                yield inner
                yield f"[{key}.{inner.strip('[]')}]"


def options(command):
    """Options of a command and of its sub-commands."""
    for parameter in command.params:
        yield from parameter.opts
        yield from parameter.secondary_opts
    for inner in getattr(command, "commands", {}).values():
        yield from options(inner)


def texts(path):
    """Strings of a module except docstrings; lines of a template without its code."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return re.sub(r"{[%{].*?[%}]}", "", source, flags=re.DOTALL).splitlines()
    tree = ast.parse(source)
    bare = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    strings = [n for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return [node.value for node in strings if id(node) not in bare]


def missing(text, known):
    return [name for advice in ADVICE.findall(text) for name in NAMED.findall(advice) if name not in known]


def known_names():
    return {*configured(ExperimentConfig), *options(typer.main.get_command(app))}


def test_every_advised_option_exists():
    known = known_names()
    wrong = [
        f"{path.relative_to(ROOT)}: {names} in {text!r}"
        for package in ("tracker", "modal_id", "sim", "modalcam")
        for pattern in ("*.py", "*.j2")
        for path in sorted((ROOT / package).rglob(pattern))
        for text in texts(path)
        if (names := missing(text, known))
    ]
    assert not wrong, "\n".join(wrong)


def test_the_check_detects_an_option_that_does_not_exist():
    known = known_names()
    assert {"fps", "[camera]", "[beam.clamp]", "--fps", "readout_s"} <= known
    assert missing("Look for the line; raise max_modes, or record again.", known) == ["max_modes"]
    assert missing("Give --frames under [cam].", known) == ["--frames", "[cam]"]
    assert missing("give --fps or [camera] fps", known) == []
