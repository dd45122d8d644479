"""Safe reading and writing of whole files.

A written file appears complete or not at all, also if the program is stopped.
"""

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
    """Read the content of a file.

    At most `most_bytes` bytes are read, also from a pipe or a device. Raise `InputError` if the
    file is missing, unreadable or larger.
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
            f"{file} has {max(size, len(content)) / 1e6:.0f} MB, but files of this kind have "
            f"at most {most_bytes / 1e6:.0f} MB: give another file."
        )
    return content


def _read(stream: BinaryIO, most_bytes: int) -> bytes:
    """Read up to `most_bytes` bytes, in parts, because one call reserves all memory at once."""
    chunks = []
    while most_bytes > 0 and (chunk := stream.read(min(most_bytes, _PART_BYTES))):
        chunks.append(chunk)
        most_bytes -= len(chunk)
    return b"".join(chunks)


def read_text(path: str | os.PathLike[str], most_bytes: int = MOST_BYTES) -> str:
    """Read a UTF-8 text file, with or without byte-order mark.

    Raise `InputError` if the file is unreadable or not UTF-8.
    """
    try:
        return read_bytes(path, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is no text file (UTF-8): give another file, or save it as UTF-8."
        ) from error


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Context manager for a binary file that appears as `path` only when the block succeeds.

    The content goes to a scratch file in the same folder, which is renamed at the end of the block.
    If the block fails, the scratch file is deleted. If `path` is a symbolic link, its target is
    replaced. Old scratch files of killed programs are deleted. Raise `InputError` if the folder is
    missing or read-only, or if `path` is a device or a pipe.
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
    """Raise `InputError` for a path that cannot be written, before a long computation.

    Reasons are a missing or read-only folder, a path that is a folder or a device, and a long name.
    Paths that are None are skipped.
    """
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
    """Convert a name, such as a camera's, to a part of a file name.

    Path separators, characters that some system refuses, and dots or blanks at both ends become
    %XX. Different names have different results.
    """
    return re.sub(
        r'[%/\\:*?"<>|]|^[. ]+|[. ]+$',
        lambda part: "".join(f"%{ord(letter):02X}" for letter in part[0]),
        name,
    )


def _resolve_link(path: Path) -> Path:
    """Return the target of a symbolic link, which may not exist yet; another path is unchanged."""
    if not path.is_symlink():
        return path
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise InputError(
            f"{path} is a link to a file that does not exist: give another name."
        ) from error


def _sweep(target: Path) -> None:
    """Delete scratch files of `target` that were not written to for an hour."""
    pattern = re.compile(re.escape(f".{target.name}.") + r"[0-9a-f]{8}\.tmp")
    with contextlib.suppress(OSError):
        for name in filter(pattern.fullmatch, os.listdir(target.parent)):
            scratch = target.with_name(name)
            if time.time() - scratch.lstat().st_mtime > ABANDONED_S:
                scratch.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file that appears complete or not at all.

    Raise `InputError` for a text with surrogates (halves of characters), or as `atomic_write` does.
    """
    expect_whole_characters(text, path)
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))


def expect_whole_characters(text: str, path: str | os.PathLike[str]) -> None:
    """Raise `InputError` if the text for a file contains surrogates (halves of characters)."""
    if has_half_characters(text):
        raise InputError(
            f"{path} was not written: a name or text contains half a character (a "
            "surrogate), which no file can contain: correct this text."
        )


def has_half_characters(text: str) -> bool:
    """True if a text contains surrogates (halves of characters), which UTF-8 cannot store."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return True
    return False


def save_table(rows: Sequence[Mapping[str, Any]], path: str | os.PathLike[str]) -> None:
    """Write rows of named values as a CSV file with one column for each name.

    Missing values, None and numbers that are not finite are left empty. The file appears complete
    or not at all, so that a program may write it again after each new row.
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
