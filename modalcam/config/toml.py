"""Reading and writing `experiment.toml`, with errors that name the key and suggest the right one."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import BaseModel, ValidationError

from modalcam.config.schema import (
    BeamConfig,
    CameraConfig,
    ExperimentConfig,
    LensConfig,
    MarkersConfig,
    PlanConfig,
    PointMassConfig,
    RecordingConfig,
    UpdatingConfig,
)
from modalcam.errors import ConfigError

CONFIG_NAME = "experiment.toml"
MAX_CONFIG_BYTES = 1_000_000

_SECTIONS: dict[str, type[BaseModel]] = {
    "camera": CameraConfig,
    "lens": LensConfig,
    "markers": MarkersConfig,
    "beam": BeamConfig,
    "recordings": RecordingConfig,
    "point_masses": PointMassConfig,
    "updating": UpdatingConfig,
}


def load_config(path: Path) -> ExperimentConfig:
    """Configuration from a TOML file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is no TOML, or holds an unknown key or a value out of range; the text
        names file, key and what to write instead.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        msg = f"{path}: cannot be read ({error.strerror})"
        raise ConfigError(msg) from error
    if len(data) > MAX_CONFIG_BYTES:
        msg = f"{path}: expected a configuration of at most {MAX_CONFIG_BYTES} bytes, found {len(data)}"
        raise ConfigError(msg)
    return _with_lenses(parse_config(_toml(path, data), where=str(path)), path)


def _with_lenses(config: ExperimentConfig, path: Path) -> ExperimentConfig:
    """Put what lens files hold in place of their names, which are relative to the configuration's folder."""

    def resolved(section: Any) -> Any:
        if not isinstance(section.lens, str):
            return section
        return section.model_copy(update={"lens": _lens(path.parent / section.lens)})

    update = {"camera": resolved(config.camera), "recordings": tuple(map(resolved, config.recordings))}
    return config.model_copy(update=update)


def _lens(path: Path) -> LensConfig:
    try:
        data = path.read_bytes()
    except OSError as error:
        msg = f"{path}: the lens cannot be read ({error.strerror}); `modalcam calibrate` writes one"
        raise ConfigError(msg) from error
    try:
        return LensConfig.model_validate(_toml(path, data))
    except ValidationError as error:
        msg = f"{path}: not a lens as `modalcam calibrate` writes it: " + "; ".join(
            _describe(detail) for detail in error.errors()
        )
        raise ConfigError(msg) from None


def _toml(path: Path, data: bytes) -> dict[str, Any]:
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        msg = f"{path}: expected UTF-8 text, found byte {data[error.start]:#04x} at offset {error.start}"
        raise ConfigError(msg) from error
    except tomllib.TOMLDecodeError as error:
        msg = f"{path}: not valid TOML: {error}"
        raise ConfigError(msg) from error


def parse_config(data: dict[str, Any], *, where: str) -> ExperimentConfig:
    """Configuration from parsed TOML; `where` names its source in errors.

    Raises
    ------
    ConfigError
        As `load_config`.
    """
    try:
        return ExperimentConfig.model_validate(data)
    except ValidationError as error:
        problems = [_describe(detail) for detail in error.errors()]
        msg = f"{where}: " + "; ".join(problems)
        raise ConfigError(msg) from None


def dump_config(config: ExperimentConfig) -> str:
    """TOML text of a configuration, without the keys that are not given."""
    sections = {"plan": PlanConfig(), "updating": UpdatingConfig()}
    unused = {name for name, default in sections.items() if getattr(config, name) == default}
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True, exclude=unused))


def _describe(detail: Any) -> str:
    path = ".".join(str(part + 1) if isinstance(part, int) else part for part in detail["loc"])
    if detail["type"] == "extra_forbidden":
        known = list(_known_keys(detail["loc"]))
        close = difflib.get_close_matches(str(detail["loc"][-1]), known, n=1)
        hint = f"did you mean {close[0]!r}?" if close else "known keys are " + ", ".join(known)
        return f"unknown key {path!r}; {hint}"
    text = str(detail["msg"]).removeprefix("Value error, ")
    found = "" if detail["type"] in ("missing", "value_error") else f", found {detail['input']!r}"
    return f"{path}: {text[:1].lower()}{text[1:]}{found}" if path else text


def _known_keys(loc: tuple[int | str, ...]) -> Iterable[str]:
    names = [part for part in loc[:-1] if isinstance(part, str)]
    section = _SECTIONS[names[-1]] if names else ExperimentConfig
    return section.model_fields.keys()
