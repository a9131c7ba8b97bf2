"""Sentences: each is called with the values of its places, and only their file words one."""

import ast
from string import Formatter

from support.paths import ROOT

from modal_id import Note, Reason, Refusal

KINDS = {"Reason": Reason, "Note": Note}
TREES = {path: ast.parse(path.read_text("utf-8")) for path in sorted((ROOT / "modal_id").rglob("*.py"))}
# Words of flags, columns, options, tables, figures and laws.
OTHER_WORDS = ["sentences", "columns", "settings", "mode_values", "results", "laws"]


def members_in(tree):
    """Members of `Reason` and `Note` that an expression names."""
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Attribute))
    return [KINDS[kind][node.attr] for node in nodes if (kind := ast.unparse(node.value)) in KINDS]


def test_each_sentence_is_called_with_the_values_of_its_places():
    calls = [(p.name, n) for p, tree in TREES.items() for n in ast.walk(tree) if isinstance(n, ast.Call)]
    for name, call in calls:
        members = members_in(call.func)
        if members and not any(isinstance(node, ast.Call) for node in ast.walk(call.func)):
            places = {place for one in members for _, place, *_ in Formatter().parse(one.words) if place}
            given = {keyword.arg for keyword in call.keywords}
            assert given == places, f"{name}:{call.lineno}: {members} has {places}, given {given}"


def test_each_sentence_is_used():
    used = {one for tree in TREES.values() for one in members_in(tree)}
    assert used == {*Reason, *Note}


def is_no_sentence(node):
    """Whether a node is documentation, a caller's mistake, or a column of a table."""
    if isinstance(node, ast.Assign):
        return ast.unparse(node.targets[0]) == "msg"
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "Column"


def test_no_other_file_words_a_sentence():
    for path in (path for path in TREES if path.stem not in OTHER_WORDS):
        apart = {id(n) for one in ast.walk(TREES[path]) if is_no_sentence(one) for n in ast.walk(one)}
        texts = [n.value for n in ast.walk(TREES[path]) if isinstance(n, ast.Constant) and id(n) not in apart]
        assert not [text for text in texts if isinstance(text, str) and len(text.split()) > 3], path


def test_a_refusal_of_several_names_each_once():
    first, second = Reason.NAMED_IS_DRIFT(hz=1.0, lowest_hz=2.0), Reason.CLIPPED()
    both = Refusal.joined((first, second, first)).at("a.csv")
    assert not both
    assert (both.codes, both.values) == (("NAMED_IS_DRIFT", "CLIPPED"), {"hz": 1.0, "lowest_hz": 2.0})
    assert str(both) == f"a.csv: {first.reason}; {second.reason}"
