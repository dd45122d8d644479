"""Files read whole, and files written whole or not at all, whatever stops the program."""

import contextlib
import csv
import errno
import io
import math
import os
import re
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from trinoc.errors import InputError, expect_path

# A file is written in seconds; another program may be writing a younger one.
ABANDONED_S = 3600
# Of a write: the disk, a quota or a limit is full, or the disk fails. Python does not say where.
_DISK = {
    getattr(errno, name)
    for name in ("ENOSPC", "EDQUOT", "EFBIG", "EIO", "EROFS")
    if hasattr(errno, name)
}
# A rig of a hundred cameras with its covariance has 10 MB.
MOST_BYTES = 64_000_000
_PART_BYTES = 1 << 22
# File systems take 255; a file being written has a longer name than it gets.
LONGEST_NAME_BYTES = 240


def read_bytes(path: str | os.PathLike[str], most_bytes: int = MOST_BYTES) -> bytes:
    """The content of a file. Raises InputError where it is missing, unreadable or huge.

    No more than `most_bytes` bytes are read, also of a pipe or a device, which have no size.
    """
    expect_path(path)
    file = Path(path)
    try:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            content = _read(stream, most_bytes + 1) if size <= most_bytes else b""
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        is_long = getattr(error, "errno", None) == errno.ENAMETOOLONG
        remedy = "give a file of a shorter name" if is_long else "give a readable file"
        raise InputError(f"{file} cannot be read ({reason}): {remedy}.") from error
    if max(size, len(content)) > most_bytes:
        raise InputError(
            f"{file} has {max(size, len(content)) / 1000000.0:.0f} MB, but files of this kind have "
            f"at most {most_bytes / 1000000.0:.0f} MB: give another file."
        )
    return content


def _read(stream: BinaryIO, most_bytes: int) -> bytes:
    """Up to `most` bytes. Python takes memory for all that one call may read."""
    parts = []
    while most_bytes > 0 and (part := stream.read(min(most_bytes, _PART_BYTES))):
        parts.append(part)
        most_bytes -= len(part)
    return b"".join(parts)


def read_text(path: str | os.PathLike[str], most_bytes: int = MOST_BYTES) -> str:
    """The text of a file, with or without a byte-order mark. Raises InputError for no UTF-8."""
    try:
        return read_bytes(path, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is no text file (UTF-8): give another file, or save it as UTF-8."
        ) from error


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file that takes the name `path` when the block ends, and vanishes if it fails.

    It is written in the folder of `path`, because a file is renamed in one step only within
    one file system. Where `path` is a symbolic link, the file that it names is replaced and the
    link stays. What a killed program left of an earlier attempt is swept. Raises InputError where
    the folder is missing or cannot be written to, and for what is no plain file, such as a device.
    """
    expect_place(path)
    target = _resolve_link(Path(path))
    _sweep(target)
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
    except BaseException as error:
        scratch.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in _DISK and error.filename is None:
            raise InputError(
                f"{target} was not written ({error.strerror}): free some disk space, or choose "
                "another place."
            ) from error
        raise


def expect_place(*paths: str | os.PathLike[str] | None) -> None:
    """Before a long job: raise InputError for a file that has no folder, or is a folder."""
    for path in paths:
        if path is None:
            continue
        named = Path(path)
        if len(os.fsencode(named.name)) > LONGEST_NAME_BYTES:
            raise InputError(
                f"The name of the file {named.name} is longer than {LONGEST_NAME_BYTES} bytes: "
                "choose a shorter one."
            )
        target = _resolve_link(named)
        if target.is_dir():
            raise InputError(f"{named} is a folder: give the name of a file to write.")
        if not target.parent.is_dir():
            raise InputError(f"The folder {target.parent} does not exist: create it first.")
        if not os.access(target.parent, os.W_OK):
            raise InputError(
                f"{target} cannot be written (nothing may be written to its folder): choose "
                "another place."
            )
        if named.exists() and not named.is_file():
            raise InputError(
                f"{named} is a device or a pipe, which cannot be replaced in one step: give the "
                "name of a file to write."
            )


def as_file_name(name: str) -> str:
    """A name, such as a camera's, as a part of a file's name; other names give other ones.

    What parts folders, or what some system refuses, becomes %XX, and so do dots at its ends.
    """
    return re.sub(
        r'[%/\\:*?"<>|]|^[. ]+|[. ]+$',
        lambda part: "".join(f"%{ord(letter):02X}" for letter in part[0]),
        name,
    )


def _resolve_link(path: Path) -> Path:
    """The file that a symbolic link names, be it there or not; any other path itself."""
    if not path.is_symlink():
        return path
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(
            f"{path} is a link to a file that does not exist: give another name."
        ) from error


def _sweep(target: Path) -> None:
    """Remove scratch files of `target` that nobody has written to for an hour."""
    pattern = re.compile(re.escape(f".{target.name}.") + r"[0-9a-f]{8}\.tmp")
    with contextlib.suppress(OSError):
        for name in filter(pattern.fullmatch, os.listdir(target.parent)):
            scratch = target.with_name(name)
            if time.time() - scratch.lstat().st_mtime > ABANDONED_S:
                scratch.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file as `atomic_write` does."""
    expect_whole_characters(text, path)
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))


def expect_whole_characters(text: str, path: str | os.PathLike[str]) -> None:
    """Raise InputError if a text for the file contains surrogates."""
    if has_half_characters(text):
        raise InputError(
            f"{path} was not written: a name or text contains half a character (a "
            "surrogate), which no file can contain: correct this text."
        )


def has_half_characters(text: str) -> bool:
    """Test a text for surrogates, which no file can hold as UTF-8."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return True
    return False


def save_table(rows: Sequence[Mapping[str, Any]], path: str | os.PathLike[str]) -> None:
    """Write rows under the names of all their columns; what a row lacks, and NaN, stays empty.

    The file is whole or not there, so that it may be written again after every row.
    """
    # The longest row has them all in order; one that failed has fewer.
    fullest = max(rows, key=len, default={})
    names = list(dict.fromkeys(name for row in (fullest, *rows) for name in row))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([_cell(row.get(name)) for name in names])
    write_text(path, out.getvalue())


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
