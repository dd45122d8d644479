"""Names as docs/conventions.md asks: functions are verbs or nouns, never participles."""

import ast
import re
from collections import defaultdict

import pytest

from tests.package import ROOT, list_files, parse_file

ROOMS = sorted(path.parent.name for path in ROOT.glob("*/__init__.py"))

PARTICIPLE = re.compile(r"(?!need|feed|speed|seed|embed|shed|red|bed|proceed|succeed|exceed)\w+ed")
IRREGULAR = {
    *("told", "shown", "seen", "found", "given", "taken", "drawn", "known", "said", "kept", "left"),
    *("made", "chosen", "written", "bent", "met", "held", "lit", "thrown", "torn", "worn", "borne"),
    *("broken", "hidden"),
}
# In no name: words of a private language, for which the glossary has others.
NOT_USED = {"told", "asked", "judged", "settled", "weighed", "turned_round", "look_apart", "sight"}
PREPOSITIONS = {
    *("of", "at", "for", "in", "on", "by", "with", "from", "to", "as", "under", "beside", "behind"),
    *("near", "between", "within", "without"),
}


def definitions(room):
    """(file, node, whether it is a method) of every class and function of a room but properties."""
    for path in list_files(room):
        tree = parse_file(path)
        classes = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
        methods = {id(node) for each in classes for node in each.body}
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not is_property(node):
                yield path.relative_to(ROOT).as_posix(), node, id(node) in methods


def is_property(node):
    return any(
        isinstance(each, ast.Name) and each.id in ("property", "cached_property")
        for each in node.decorator_list
    )


def words_of(name):
    """`fit_lines`, `FitLines` -> fit, lines."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+", name)]


def is_participle(word):
    return word in IRREGULAR or PARTICIPLE.fullmatch(word) is not None


@pytest.mark.parametrize("room", ROOMS)
def test_no_function_is_named_by_a_participle_or_ends_in_a_preposition(room):
    """A participle may describe a noun, as in `signed_distance`; a method's preposition goes with
    its argument, as in `edges_at(vertex)`."""
    wrong = []
    for file, node, is_method in definitions(room):
        words = words_of(node.name)
        if not isinstance(node, ast.FunctionDef) or not words or node.name.startswith("__"):
            continue
        alone = len(words) == 1 and (is_participle(words[0]) or words[0] in PREPOSITIONS)
        if (alone and node.name != "of") or (words[-1] in PREPOSITIONS and not is_method):
            wrong.append(f"{file}:{node.lineno} {node.name}")
    assert wrong == []


@pytest.mark.parametrize("room", ROOMS)
def test_no_class_is_a_participle_and_no_name_uses_words_that_are_not_used(room):
    wrong = []
    for file, node, _ in definitions(room):
        words = words_of(node.name)
        if isinstance(node, ast.ClassDef) and words and is_participle(words[-1]):
            wrong.append(f"{file}:{node.lineno} {node.name}")
        if set(words) & NOT_USED or any(f"_{each}_" in f"_{node.name}_" for each in NOT_USED):
            wrong.append(f"{file}:{node.lineno} {node.name}")
    assert wrong == []


def test_no_class_and_no_public_function_stands_twice():
    places = defaultdict(list)
    for path in list_files():
        for node in parse_file(path).body:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            if any(ast.unparse(each) == "overload" for each in node.decorator_list):
                continue
            if isinstance(node, ast.ClassDef) or not node.name.startswith("_"):
                places[node.name].append(path.relative_to(ROOT).as_posix())
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
