"""Files that are either whole or not there, whatever stops the program."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from trinoc.errors import InputError


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file that takes the name `path` when the block ends, and vanishes if it fails.

    It is written in the folder of `path`, because a file is renamed in one step only within
    one file system. Raises InputError where the folder is missing or cannot be written to.
    """
    target = Path(path)
    expect_place(target)
    scratch = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        # Unlike the files of `tempfile`, this one gets the permissions of any new file.
        file = open(scratch, "xb")  # noqa: SIM115
    except OSError as error:
        raise InputError(
            f"{target} cannot be written ({error.strerror}): choose another place."
        ) from error
    try:
        with file:
            yield file
        os.replace(scratch, target)
    except BaseException:
        scratch.unlink(missing_ok=True)
        raise


def expect_place(*paths: str | os.PathLike[str] | None) -> None:
    """Before a long job: raise InputError for a file that has no folder, or is a folder."""
    for path in paths:
        if path is None:
            continue
        target = Path(path)
        if target.is_dir():
            raise InputError(f"{target} is a folder: give the name of a file to write.")
        if not target.parent.is_dir():
            raise InputError(f"The folder {target.parent} does not exist: create it first.")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file as `atomic_write` does."""
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))
