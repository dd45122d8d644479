"""Every name in the code is defined.

Ruff and pyright do not test this here: they take the dimensions in jaxtyping's strings, such as
Float[Array, "n 2"], for undefined names.
"""

import builtins
import symtable
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("trinoc", "tests", "benchmarks", "simulation", "docs")
FILES = sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
# Names that Python defines in every module.
OF_MODULES = {"__file__", "__name__", "__doc__", "__path__", "__spec__", "__debug__"}


def global_names(table: symtable.SymbolTable) -> Iterator[str]:
    """Names that a scope and the scopes in it look up in the module."""
    for symbol in table.get_symbols():
        if symbol.is_referenced() and (symbol.is_global() or table.get_type() == "module"):
            yield symbol.get_name()
    for child in table.get_children():
        yield from global_names(child)


def undefined_names(source: str) -> set[str]:
    """Names that a module uses and neither it nor Python defines."""
    table = symtable.symtable(source, "module", "exec")
    defined = {
        symbol.get_name()
        for symbol in table.get_symbols()
        if symbol.is_assigned() or symbol.is_imported() or symbol.is_namespace()
    }
    return set(global_names(table)) - defined - set(dir(builtins)) - OF_MODULES


def test_an_undefined_name_is_found_in_any_scope() -> None:
    source = "import os\nA = 1\ndef f(x):\n    return [os.path, A, x, missing] + [k for k in x]\n"
    assert undefined_names(source) == {"missing"}
    assert undefined_names(source.replace("missing", "len")) == set()


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_name_is_defined(folder: str) -> None:
    undefined = {
        str(file.relative_to(ROOT)): names
        for file in FILES
        if file.is_relative_to(ROOT / folder)
        and (names := undefined_names(file.read_text(encoding="utf-8")))
    }
    assert not undefined
