"""Every option that a sentence advises exists."""

import ast
import inspect
import re
from collections.abc import Iterator

import trinoc
from tests.package import list_files, parse_file
from trinoc.cli.lens_options import SIGMA
from trinoc.cli.main import COMMANDS, find_command
from trinoc.cli.options import list_options
from trinoc.cli.segments import FIND


def options_of(command: str) -> set[str]:
    every = list_options(find_command(command))
    return {name for option in every for name in (option.typed, *option.aliases)}


OPTIONS = {name: options_of(name) for name in COMMANDS}
ALL = {"--help", "--version"}.union(*OPTIONS.values())
# What a sentence advises to give, check or set.
ADVISED = re.compile(r"(?:give|check|set|with|by) (?:an? |the )?([a-z]+(?:_[a-z]+)+)")
# Public functions whose parameters sentences advise, and the command of each.
FUNCTIONS = {
    trinoc.calibrate: "calibrate",
    trinoc.calibrate_rig: "calibrate-rig",
    trinoc.calibrate_intrinsics: "intrinsics",
    trinoc.match_segments: "match",
    trinoc.find_segments: "segments",
    trinoc.refine: "refine",
}


def sentences() -> Iterator[tuple[str, str]]:
    """(file, text) of every string of the package that is a sentence, docstrings left out."""
    for path in list_files():
        tree = parse_file(path)
        documented = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
                continue
            if id(node) not in documented and " " in node.value:
                yield path.name, node.value


def test_every_option_that_a_sentence_names_exists() -> None:
    wrong = [
        f"{file}: {option}"
        for file, text in sentences()
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)
        if option not in ALL
    ]
    assert wrong == []


def test_an_option_of_a_command_line_is_one_of_that_command() -> None:
    lines = [
        (file, *match)
        for file, text in sentences()
        for match in re.findall(r"trinoc ([a-z-]+)([^`]*)", text)
        if match[0] in COMMANDS
    ]
    assert len(lines) > 10
    wrong = [
        f"{file}: trinoc {command} {option}"
        for file, command, options in lines
        for option in re.findall(r"(?<![\w-])--?[a-z][a-z-]*", options)
        if option not in OPTIONS[command]
    ]
    assert wrong == []


def test_a_parameter_that_a_sentence_advises_is_an_option_or_a_setting() -> None:
    settings = {*SIGMA, *FIND}
    missing = {
        parameter
        for function, command in FUNCTIONS.items()
        for parameter in inspect.signature(function).parameters
        if f"--{parameter.replace('_', '-')}" not in OPTIONS[command] and parameter not in settings
    }
    wrong = [
        f"{file}: {parameter}"
        for file, text in sentences()
        for parameter in ADVISED.findall(text)
        if parameter in missing
    ]
    assert "sigma_px" not in missing
    assert wrong == []
