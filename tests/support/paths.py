"""Folders that tests read from, and scripts that they use as modules."""

import importlib.util
import os
import sys
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


def script(path):
    """The module of a script outside the packages; the path of modules stays as it was."""
    spec = importlib.util.spec_from_file_location(f"script_{path.stem}", path)
    module, before = importlib.util.module_from_spec(spec), list(sys.path)
    # frozen dataclasses look up their module when their class is made
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    sys.path[:] = before
    return module
