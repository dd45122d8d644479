"""Digest of the source files of modules and of all modules that they import."""

import functools
import hashlib
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

# Import statements of a source, those inside functions too. A text that only looks like one adds a
# module, which is harmless.
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)"
    r"|import[ \t]+([\w.]+(?:[ \t]*,[ \t]*[\w.]+)*))",
    re.MULTILINE,
)
_PACKAGE = __name__.partition(".")[0]
# What is written later may differ from what this process runs.
_STARTED_S = time.time()


@functools.cache
def digest_sources(modules: frozenset[str]) -> str:
    """Digest of the source files of `modules` and of all modules that they import.

    Imports are followed within trinoc and within the top-level package of each module. Raise
    LookupError for a module without a source file, as at a prompt, or if a file has changed since
    this process started.
    """
    visited: set[str] = set()
    pending = set(modules)
    while pending:
        module = pending.pop()
        visited.add(module)
        pending |= _imports(module) - visited
    digests = sorted((module, _digest(module)) for module in visited)
    return hashlib.sha256(repr(digests).encode()).hexdigest()


@functools.cache
def _text(module: str) -> str:
    file = _source_file(module)
    if file is None:
        raise LookupError(f"{module} has no source file.")
    if file.stat().st_mtime > _STARTED_S:
        raise LookupError(f"{file} has changed since this process started.")
    return file.read_text(encoding="utf-8")


@functools.cache
def _digest(module: str) -> str:
    return hashlib.sha256(_text(module).encode()).hexdigest()


@functools.cache
def _imports(module: str) -> frozenset[str]:
    """Modules that the source of `module` imports, from trinoc or its own top-level package."""
    packages = {_PACKAGE, module.partition(".")[0]}
    names = _imported_names(_text(module), packages)
    return frozenset(name for name in names if _source_file(name) is not None)


def _imported_names(text: str, packages: set[str]) -> Iterator[str]:
    for source, names, plain in _IMPORT.findall(text):
        if plain:
            parts = re.split(r"[ \t,]+", plain)
            yield from (name for name in parts if name.partition(".")[0] in packages)
        elif source.partition(".")[0] in packages:
            yield source
            yield from (f"{source}.{name}" for name in re.findall(r"\w+", names))


@functools.cache
def _source_file(module: str) -> Path | None:
    """Source file of a module, without importing it or its packages; None if it has none."""
    root, *parts = module.split(".")
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is not None:
        return Path(file)
    for folder in getattr(sys.modules.get(root), "__path__", ()):
        path = Path(folder, *parts)
        for candidate in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
            if candidate.is_file():
                return candidate
    return None
