"""Read and write `experiment.toml`; an error names the key and suggests the right one."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError

from modalcam.common import ConfigError, InputError, readable_bytes
from modalcam.config.schema import ExperimentConfig, LensConfig, RecordingConfig
from tracker import problems

CONFIG_NAME = "experiment.toml"
MAX_CONFIG_BYTES = 1_000_000
# The parser needs memory in proportion to the square of the parts of a key.
_MOST_PARTS = 16
_LONG_KEY = re.compile(
    r"(?<![\w-])(?:(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+\.[ \t]*+){%d}" % _MOST_PARTS  # noqa: UP031
)
_HEADER = re.compile(r"[ \t]*\[(?P<list>\[)?[ \t]*(?P<name>[\w.-]+)[ \t]*\]")
_KEY = re.compile(r"[ \t]*(?:(?P<bare>[\w.-]+)|[\"'](?P<quoted>[^\"'\n]+)[\"'])[ \t]*=")
# Path of the key with which a sentence on it begins.
_NAMED = re.compile(r"unknown key '(?P<unknown>[^']+)'|(?P<known>[^\s:]+):")
_NO_CONFIG = "`modalcam init FOLDER` writes a configuration"
_NO_LENS = "`modalcam calibrate` writes a lens"
_Model = TypeVar("_Model", bound=BaseModel)


def load_config(path: Path) -> ExperimentConfig:
    """Configuration from a TOML file, or from experiment.toml in a folder, with the content of its lens files.

    ConfigError if a file cannot be read, is not TOML, or holds an unknown key or a value out of range; the text names
    file and key, and says what to write instead.
    """
    path = path / CONFIG_NAME if path.is_dir() else path
    return config_of_text(config_text(path), path)


def config_text(path: Path) -> str:
    """Text of a configuration, not parsed; ConfigError if the file cannot be read."""
    return _text(path, _NO_CONFIG)


def config_of_text(text: str, path: Path) -> ExperimentConfig:
    """Configuration from the text of a TOML file, which need not be saved; `path` and errors as in `load_config`."""
    config = _validated(ExperimentConfig, _parsed(path, text), str(path), _lines_of_keys(text))

    def with_lens(section: Any) -> Any:
        if not isinstance(section.lens, str):
            return section
        return section.model_copy(update={"lens": _lens(path.parent / section.lens)})

    recordings = tuple(map(with_lens, config.recordings))
    return config.model_copy(update={"camera": with_lens(config.camera), "recordings": recordings})


def raw_config(path: Path) -> dict[str, Any]:
    """Content of a configuration and of the lens files that it names, not validated."""
    data = _toml(path, _NO_CONFIG)
    recordings = data.get("recordings", ())
    for section in (data.get("camera"), *(recordings if isinstance(recordings, list) else ())):
        if isinstance(section, dict) and isinstance(section.get("lens"), str):
            section["lens"] = _toml(path.parent / section["lens"], _NO_LENS)
    return data


def _lens(path: Path) -> LensConfig:
    data = _toml(path, _NO_LENS)
    try:
        return LensConfig.model_validate(data)
    except ValidationError as error:
        found = "; ".join(problems(error, LensConfig))
        msg = f"{path}: expected a lens as `modalcam calibrate` writes it: {found}"
        raise ConfigError(msg) from None


def _toml(path: Path, unreadable: str) -> dict[str, Any]:
    return _parsed(path, _text(path, unreadable))


def _text(path: Path, unreadable: str) -> str:
    try:
        readable_bytes(path, MAX_CONFIG_BYTES)
        data = path.read_bytes()
    except OSError as error:
        msg = f"{path}: cannot be read ({error.strerror}); {unreadable}"
        raise ConfigError(msg) from error
    except InputError as error:
        msg = f"{error}; {unreadable}"
        raise ConfigError(msg) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        msg = f"{path}: expected UTF-8 text, found byte {data[error.start]:#04x} at offset {error.start}"
        raise ConfigError(msg) from error


def _parsed(path: Path, text: str) -> dict[str, Any]:
    if _LONG_KEY.search(text):
        msg = f"{path}: expected keys of at most three parts, found one of more than {_MOST_PARTS}"
        raise ConfigError(msg)
    try:
        data = tomllib.loads(text)
    except RecursionError:
        msg = f"{path}: expected a configuration, found brackets nested too deeply"
        raise ConfigError(msg) from None
    except ValueError as error:
        msg = f"{path}: not valid TOML: {error}"
        raise ConfigError(msg) from error
    _check_integers(path, data)
    return data


def _check_integers(path: Path, data: dict[str, Any]) -> None:
    """Refuse integers of more than 64 bits: TOML has none, and Python converts none of thousands of digits to text."""
    todo: list[Any] = [data]
    while todo:
        value = todo.pop()
        if isinstance(value, dict):
            todo.extend(value.values())
        elif isinstance(value, list):
            todo.extend(value)
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            msg = (
                f"{path}: not valid TOML: found an integer of {value.bit_length()} bits, expected at most 64"
            )
            raise ConfigError(msg)


def parse_config(data: dict[str, Any], *, where: str) -> ExperimentConfig:
    """Configuration from parsed TOML; `where` names its source in errors, which are those of `load_config`."""
    return _validated(ExperimentConfig, data, where)


def parse_recording(data: dict[str, Any], *, where: str) -> RecordingConfig:
    """Configuration of one recording, such as from the command line; `where` and errors as in `parse_config`."""
    return _validated(RecordingConfig, data, where)


def _validated(
    model: type[_Model], data: dict[str, Any], where: str, lines: Mapping[str, int] | None = None
) -> _Model:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        found = [_with_line(sentence, lines or {}) for sentence in problems(error, model)]
        msg = f"{where}: {'; '.join(found)}"
        raise ConfigError(msg) from None


def _lines_of_keys(text: str) -> dict[str, int]:
    """Line of each key that stands at the beginning of a line, by its path as errors name it: ``recordings.2.fps``."""
    section, count, lines = "", dict[str, int](), dict[str, int]()
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            name = header["name"]
            if header["list"]:
                count[name] = count.get(name, 0) + 1
                name = f"{name}.{count[name]}"
            section = f"{name}."
            lines.setdefault(name, number)
        elif key := _KEY.match(line):
            lines.setdefault(section + (key["bare"] or key["quoted"]), number)
    return lines


def _with_line(sentence: str, lines: Mapping[str, int]) -> str:
    path = _NAMED.match(sentence)
    number = lines.get(path["unknown"] or path["known"]) if path else None
    return sentence if number is None else f"line {number}: {sentence}"


def dump_config(config: ExperimentConfig) -> str:
    """TOML text of a configuration, without keys that have no value and optional sections left at their defaults."""
    optional = ("plan", "updating", "damping")
    unused = {name for name in optional if getattr(config, name) == getattr(ExperimentConfig(), name)}
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True, exclude=unused))
