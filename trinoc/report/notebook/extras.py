"""Libraries that a plain installation does not bring."""

import importlib.util

from trinoc.errors import InputError


def expect_extra(library: str, extra: str) -> None:
    """Raise InputError, with the command that installs it, where a library is missing."""
    if importlib.util.find_spec(library) is None:
        raise InputError(f"This needs {library}: pip install 'trinoc[{extra}]'.")
