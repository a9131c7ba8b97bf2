"""Functions that only kernels call are compiled wherever they run, and only these are left out of the coverage."""

import ast
import re

from support.paths import ROOT

PACKAGES = ("tracker", "modal_id", "sim", "modalcam")
INNER, COMPILED = "register_jitable", {"register_jitable", "njit", "intrinsic"}


def module(path):
    """Name by which a file is imported."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def decorators(node):
    """Last names of the decorators of a function; none of any other node."""
    if not isinstance(node, ast.FunctionDef):
        return set()
    return {ast.unparse(one).partition("(")[0].rpartition(".")[2] for one in node.decorator_list}


def inner_functions(tree):
    """Names of the functions that only kernels call."""
    return {node.name for node in ast.walk(tree) if INNER in decorators(node)}


def used_outside(tree, names, dotted):
    """Uses of names, and of `dotted` ones as ``module.name``, outside compiled functions, each with its line."""
    if decorators(tree) & COMPILED:
        return []
    used = ""
    if isinstance(tree, ast.Name) and tree.id in names:
        used = tree.id
    elif isinstance(tree, ast.Attribute) and isinstance(tree.value, ast.Name):
        used = f"{tree.value.id}.{tree.attr}"
        used = used if used in dotted else ""
    found = [(used, tree.lineno)] if used else []
    return found + [one for child in ast.iter_child_nodes(tree) for one in used_outside(child, names, dotted)]


def test_functions_that_only_kernels_call_are_not_called_by_python():
    texts = {path: path.read_text("utf-8") for name in PACKAGES for path in (ROOT / name).rglob("*.py")}
    inner = {path: inner_functions(ast.parse(text)) for path, text in texts.items() if f"@{INNER}" in text}
    everywhere = set().union(*inner.values())
    assert len(everywhere) > 20, f"@{INNER} is no longer recognised"
    named = re.compile(rf"\b({'|'.join(everywhere)})\b")
    dotted = {f"{path.stem}.{name}" for path, names in inner.items() for name in names}
    for path, text in texts.items():
        if not named.search(text):
            continue
        tree = ast.parse(text)
        # A name that a package re-exports comes from one of its modules.
        imported = {
            one.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for one in node.names
            for where, names in inner.items()
            if one.name in names and module(where).startswith(str(node.module))
        }
        bad = used_outside(tree, inner.get(path, set()) | imported, dotted)
        assert not bad, (
            f"{path.relative_to(ROOT)}: expected calls of @{INNER} functions in compiled ones alone, found {bad}, "
            "which would run uncompiled and unmeasured; use @njit for them"
        )


def test_a_call_by_python_is_found():
    code = "@njit(cache=True)\ndef kernel():\n    inner()\n\ndef python():\n    {}()\n"
    assert used_outside(ast.parse(code.format("inner")), {"inner"}, set()) == [("inner", 6)]
    assert used_outside(ast.parse(code.format("march.inner")), set(), {"march.inner"}) == [("march.inner", 6)]
    assert not used_outside(ast.parse(code.format("kernel")), {"inner"}, {"march.inner"})
    code = "@extending.register_jitable(fastmath=True)\ndef inner():\n    pass\n"
    assert inner_functions(ast.parse(code)) == {"inner"}
