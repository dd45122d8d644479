"""Exported names, documented names and `--help` agree, and the version is one."""

import importlib
import importlib.metadata
import re
from pathlib import Path

import pytest

import trinoc
from trinoc.cli.main import main

ROOT = Path(__file__).parent.parent
REFERENCE = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")


def test_every_exported_name_is_there_and_documented_by_its_own_docstring():
    for name in trinoc.__all__:
        assert getattr(trinoc, name).__doc__, name


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="callibrate"):
        _ = trinoc.callibrate  # pyright: ignore[reportAttributeAccessIssue]


def help_of(capsys, *command):
    assert main([*command, "--help"]) == 0
    return capsys.readouterr().out


def commands(capsys):
    """Names of the commands in `trinoc --help`."""
    listed = re.search(r"\{([\w,-]+)\}", help_of(capsys))
    assert listed
    return listed[1].split(",")


def test_commands_are_those_of_the_reference(capsys):
    documented = re.findall(r"^### `trinoc ([\w-]+)`", REFERENCE, re.MULTILINE)
    assert sorted(documented) == sorted(commands(capsys))


def test_options_are_those_of_the_reference(capsys):
    sections = dict(re.findall(r"^### `trinoc ([\w-]+)`\n(.*?)(?=^##)", REFERENCE, re.M | re.S))
    for command in commands(capsys):
        offered = set(re.findall(r"--[a-z][a-z0-9-]*", help_of(capsys, command)))
        documented = set(re.findall(r"--[a-z][a-z0-9-]*", sections[command]))
        assert documented == offered - {"--help", "--json", "--quiet", "--force"}, command


def test_options_of_the_reference_are_as_their_classes_declare_them(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    script = importlib.import_module("make_reference")
    assert script.with_options(REFERENCE) == REFERENCE, "run python docs/make_reference.py"


def test_the_page_of_messages_has_those_of_the_code(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    script = importlib.import_module("make_messages")
    page = script.PAGE.read_text(encoding="utf-8")
    assert script.with_messages(page) == page, "run python docs/make_messages.py"


def test_version_is_that_of_the_installed_package_and_of_the_citation():
    try:
        installed = importlib.metadata.version("trinoc")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("run from the source tree, nothing installed")
    assert installed == trinoc.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {trinoc.__version__}\n" in citation
