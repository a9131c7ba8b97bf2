"""The studio is an extra: without it, these tests are not collected."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("nicegui") and find_spec("tomlkit") else ["test_*.py"]
