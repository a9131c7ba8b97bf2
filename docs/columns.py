"""Write docs/columns.md from the registry of the tables' columns: `python docs/columns.py`."""

from __future__ import annotations

from pathlib import Path

from modalcam.plugins import load_apps
from modalcam.tables import markdown

load_apps("plugin")
Path(__file__).with_suffix(".md").write_text(markdown(), encoding="utf-8")
