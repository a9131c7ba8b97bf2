"""Folders that tests read from."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# False where modalcam/apps was deleted, which leaves the core
APPS = (ROOT / "modalcam" / "apps").is_dir()
COMMANDS_OF_APPS = ["demo", "render", "plan", "paper", "markers", "calibrate", "studio", "pick"]
COMMANDS_OF_APPS += ["compare", "deck", "material", "preview"]
SAMPLES = ROOT / "sample_videos"
# third-party recordings; without them, the tests that need them are skipped
REALDATA = Path(os.environ.get("MODALCAM_REALDATA") or ROOT / "realdata")
REALDATA_ABSENT = (
    "no real recordings: `python -m tests.realdata` fetches them, or MODALCAM_REALDATA names their folder"
)
