"""Lines of each package against its budget in pyproject.toml, and their change against the main branch."""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def counted(path: str, parts: dict[str, str]) -> str | None:
    """Part with the longest folder that holds a Python file; None outside all."""
    inside = [
        part for part, folder in parts.items() if path.startswith(f"{folder}/") and path.endswith(".py")
    ]
    return max(inside, key=lambda part: len(parts[part]), default=None)


def lines_now(parts: dict[str, str]) -> dict[str, int]:
    """Lines of the files that git knows."""
    sums = dict.fromkeys(parts, 0)
    for path in git("ls-files").splitlines():
        if (part := counted(path, parts)) and (ROOT / path).exists():
            sums[part] += len((ROOT / path).read_bytes().splitlines())
    return sums


def changes(parts: dict[str, str]) -> dict[str, int]:
    """Lines added less lines removed since the main branch; empty where there is none."""
    sums = dict.fromkeys(parts, 0)
    for base in ("origin/main", "main"):
        try:
            table = git("diff", "--numstat", "--no-renames", base)
        except subprocess.CalledProcessError:
            continue
        for row in table.splitlines():
            added, removed, path = row.split("\t")
            if part := counted(path, parts):
                sums[part] += int(added) - int(removed)
        return sums
    return {}


def git(*arguments: str) -> str:
    """Output of a git command."""
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout  # noqa: S603


def main() -> int:
    """Print the table; 1 if a part is above its budget."""
    budget = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["modalcam"]["budget"]
    parts = {name: entry["folder"] for name, entry in budget.items()}
    now, change = lines_now(parts), changes(parts)
    over = [name for name in parts if now[name] > budget[name]["lines"]]
    for name in parts:
        against = f"{change[name]:+7d} against main" if change else ""
        limit = budget[name]["lines"]
        print(f"{name:10}{now[name]:7d} of {limit:6d} lines {against}{'  ABOVE' * (name in over)}")
    if over:
        print("remove lines, or raise the budget with a record in docs/decisions that says why")
    return int(bool(over))


if __name__ == "__main__":
    sys.exit(main())
