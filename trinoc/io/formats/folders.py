"""Folders that are either whole or not there, as files are by `atomic_write`."""

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from trinoc.errors import InputError


@contextlib.contextmanager
def atomic_folder(target: Path) -> Iterator[Path]:
    """A scratch folder that takes the name `target` when the block ends, and vanishes if it fails.

    `target` is new or empty. Raises InputError where it cannot be written.
    """
    scratch = target.absolute().with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        scratch.mkdir()
    except OSError as error:
        raise InputError(
            f"{target} cannot be written ({error.strerror}): choose another place."
        ) from error
    try:
        yield scratch
        if target.is_dir():
            target.rmdir()  # fails unless empty
        os.replace(scratch, target)
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise
