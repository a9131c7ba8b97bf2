"""Where results come from: hashes of inputs, versions, and keys that change when anything they rest on does."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
from functools import cache
from pathlib import Path
from typing import Any

import modalcam
from tracker.video.registry import input_files

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "emcee",
    "av",
    "opencv-contrib-python-headless",
    "scikit-image",
    "tifffile",
    "pandas",
    "matplotlib",
    "pydantic",
    "jinja2",
    "xarray",
    "h5netcdf",
)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def recording_sha256(path: Path) -> str:
    """SHA-256 of a recording: of its file, or of the names and hashes of all files that it is made of."""
    files = input_files(path)
    if files == (path,):
        return file_sha256(path)
    digest = hashlib.sha256()
    for file in files:
        digest.update(os.fsencode(file.name) + b"\0" + file_sha256(file).encode())
    return digest.hexdigest()


def versions() -> tuple[tuple[str, str], ...]:
    """Version of the program, of Python and of the libraries that results depend on."""
    return (
        ("modalcam", modalcam.__version__),
        ("python", platform.python_version()),
        *((name, importlib.metadata.version(name)) for name in LIBRARIES),
    )


@cache
def code_sha256(*packages: str) -> str:
    """Hash of the source of packages of ours: results of another version of the code are not taken for today's."""
    digest = hashlib.sha256()
    for package in packages:
        spec = importlib.util.find_spec(package)
        for root in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(Path(root).rglob("*.py")):
                digest.update(path.relative_to(root).as_posix().encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()


def stage_key(stage: str, **basis: Any) -> str:
    """Hash of everything that a stage's result rests on, given as JSON-able values."""
    text = json.dumps({"stage": stage, **basis}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def opencv_wheels() -> tuple[str, ...]:
    """Installed distributions that bring OpenCV; more than one overwrite each other's files."""
    names = (d.metadata["Name"] or "" for d in importlib.metadata.distributions())
    return tuple(sorted({name for name in names if name.startswith("opencv-")}))
