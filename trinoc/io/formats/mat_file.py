"""Variables of a MATLAB file (-v6, -v7), read by SciPy in a child process."""

import io
import os
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.io.atomic import MOST_BYTES, read_bytes
from trinoc.io.child_process import DamagedError, read_in_child

_HEADER_BYTES, _ENDIAN_MARKS = 128, (b"IM", b"MI")


def mat_variables(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the variables of a MATLAB file, keyed by name, as JSON values.

    Structs become dictionaries, cell arrays lists, texts strings, and matrices lists of rows.
    Complex, sparse and other values become None. Raise `InputError` for a file that is damaged, of
    another format, or of version 7.3.
    """
    content = read_bytes(path)
    if content[:20].startswith(b"MATLAB 7.3") or content.startswith(b"\x89HDF"):
        raise InputError(
            f"{path} is a file of MATLAB 7.3, which trinoc does not read: save the data with -v7."
        )
    if len(content) < _HEADER_BYTES or content[126:128] not in _ENDIAN_MARKS:
        raise InputError(f"{path} is no .mat file that trinoc reads: save it with -v7.")
    return read_in_child(f"{__name__}:read_variables", content, path)


def read_variables(content: bytes) -> dict[str, Any]:
    """Convert the content of a MATLAB file to JSON values. Runs in a child process."""
    import scipy.io

    variables = scipy.io.loadmat(io.BytesIO(content))
    named = {name: value for name, value in variables.items() if not name.startswith("__")}
    if sum(map(_count_bytes, named.values())) > MOST_BYTES:
        raise DamagedError("the file unpacks to more than any calibration")
    return {name: _json_value(value) for name, value in named.items()}


def _count_bytes(value: Any) -> int:
    if not isinstance(value, np.ndarray):
        return 0
    if value.dtype.names:
        return sum(_count_bytes(value[field]) for field in value.dtype.names)
    if value.dtype == object:
        return value.nbytes + sum(map(_count_bytes, value.flat))
    return value.nbytes


def _json_value(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.names:
        # An array of several structs is no part of a calibration.
        fields = value.dtype.names if value.size == 1 else None
        return fields and {name: _json_value(value.flat[0][name]) for name in fields}
    if value.dtype.kind == "U":
        text = "".join(value.flat)
        return text.encode("utf-8", "replace").decode() if value.size < 2 else None
    if value.ndim != 2:
        return None
    if value.dtype == object:
        return [_json_value(member) for member in value.ravel(order="F")]
    return value.astype(np.float64).tolist() if value.dtype.kind in "biuf" else None
