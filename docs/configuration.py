"""Write docs/configuration.md from the fields of the configuration: `python docs/configuration.py`."""

from __future__ import annotations

from pathlib import Path

from modalcam.config import markdown

Path(__file__).with_suffix(".md").write_text(markdown(), encoding="utf-8")
