"""Digest of the sources that a program is made from: modules, and all that these import."""

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
    """Digest of the sources of modules and of all that they import within trinoc or within the
    top-level package of their own.

    Raises LookupError for a module without a source file, such as that of a prompt, or whose file
    has changed since this process started.
    """
    reached: set[str] = set()
    waiting = set(modules)
    while waiting:
        module = waiting.pop()
        reached.add(module)
        waiting |= _imports(module) - reached
    digests = sorted((module, _digest(module)) for module in reached)
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
    """The modules of trinoc, and of the module's own package, that its source names."""
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
    """The file of a module, imported or not; its packages are not imported to find it."""
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
