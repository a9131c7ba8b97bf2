"""Write the table of folders in docs/architecture.md: ``python docs/architecture.py``, from the root.

The content of a folder is the first paragraph of its README; its imports are those of its files. A folder stands after
all that it imports: the order that the tests enforce.
"""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_suffix(".md")
PACKAGES = ("tracker", "modal_id", "sim", "modalcam")
BEGIN, END = "<!-- folders: begin -->\n", "<!-- folders: end -->"


def folders(package: str) -> list[str]:
    """Names of a package and of the folders in it that hold Python files."""
    return sorted({p.parent.relative_to(ROOT).as_posix() for p in (ROOT / package).rglob("*.py")})


def imported(folder: str, known: list[str]) -> set[str]:
    """Other folders that the files of a folder import, at the top or within a function."""
    found = set()
    for path in (ROOT / folder).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                name = node.module.replace(".", "/")
                inside = [k for k in known if f"{name}/".startswith(f"{k}/")]
                found.update(inside and [max(inside, key=len)])
    return found - {folder}


def content(folder: str) -> str:
    """First paragraph of the folder's README."""
    text = (ROOT / folder / "README.md").read_text(encoding="utf-8")
    return " ".join(text.split("\n\n")[1].split())


def table() -> str:
    """Table of all folders, in the order of their imports."""
    rows = ["| folder | content | imports |", "| --- | --- | --- |"]
    known = [name for package in PACKAGES for name in folders(package)]
    for package in PACKAGES:
        uses = {folder: imported(folder, known) for folder in folders(package)}
        # The files of a folder are used by the folders in it, and join them: those imports are no step of the order.
        inner = {
            folder: {u for u in used if u in uses and not f"{u}/".startswith(f"{folder}/")}
            for folder, used in uses.items()
        }
        sorter = TopologicalSorter(inner)
        sorter.prepare()
        order = []
        while sorter.is_active():
            ready = sorted(sorter.get_ready())
            order += ready
            sorter.done(*ready)
        rows += [
            f"| `{folder}` | {content(folder)} | {short(folder, uses[folder], package)} |" for folder in order
        ]
    return "\n".join(rows) + "\n"


def short(folder: str, used: set[str], package: str) -> str:
    """Folders of the own package by their names within it, then other packages."""
    own = (
        "all folders below"
        if folder == package
        else ", ".join(
            f"`{u.removeprefix(package + '/')}`" for u in sorted(used) if u.startswith(f"{package}/")
        )
    )
    others = ", ".join(
        f"`{p}`" for p in PACKAGES if p != package and any(f"{u}/".startswith(f"{p}/") for u in used)
    )
    return "; ".join(filter(None, (own, others)))


def markdown() -> str:
    """Content of the page with the table as it is now."""
    text = PAGE.read_text(encoding="utf-8")
    return re.sub(f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}{table()}{END}", text, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(markdown(), encoding="utf-8")
