"""OpenCV's FileStorage as a file: maps, lists of maps, matrices, numbers and texts."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from trinoc.errors import InputError
from trinoc.io.atomic import write_text
from trinoc.io.formats.text_files import block_of, read_text
from trinoc.io.formats.yaml_text import scalar_or_list
from trinoc.io.json_document import Block


def write_storage(document: dict[str, Any], path: Path) -> None:
    """Write a map as YAML, or as JSON where the name says so; arrays become matrices."""
    as_json = path.suffix.lower() == ".json"
    write_text(path, _json(document) if as_json else "%YAML:1.0\n---\n" + _yaml(document, ""))


def read_storage(path: Path) -> Block:
    """The file as OpenCV reads it, matrices as lists of rows. Raises InputError for others."""
    text = read_text(path)
    # OpenCV writes about broken files on stderr; the sentence below says it better.
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values = _plain(storage.root())
        storage.release()
    except (cv2.error, SystemError, RecursionError) as error:
        raise InputError(
            f"{path} is not a file of cv2.FileStorage (YAML or JSON): give another file."
        ) from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    return block_of(values, path)


def _plain(node: Any) -> Any:
    if node.isMap():
        keys = node.keys()
        if {"rows", "cols", "dt", "data"} <= set(keys):
            matrix = node.mat()
            return None if matrix is None else np.atleast_2d(matrix).tolist()
        return {key: _plain(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_plain(node.at(index)) for index in range(node.size())]
    if node.isString():
        return node.string()
    return node.real() if node.isInt() or node.isReal() else None


def _yaml(values: dict[str, Any], indent: str) -> str:
    lines = []
    for key, value in values.items():
        if isinstance(value, dict):
            lines.append(f"{indent}{key}:\n{_yaml(value, indent + '   ')}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            inner = indent + "      "
            items = (f"{indent}   -\n{_yaml(item, inner)}" for item in value)
            lines.append(f"{indent}{key}:\n{''.join(items)}")
        elif isinstance(value, np.ndarray):
            data = scalar_or_list(value.ravel().tolist())
            lines.append(
                f"{indent}{key}: !!opencv-matrix\n{indent}   rows: {value.shape[0]}\n"
                f"{indent}   cols: {value.shape[1]}\n{indent}   dt: d\n{indent}   data: {data}\n"
            )
        else:
            lines.append(f"{indent}{key}: {scalar_or_list(value)}\n")
    return "".join(lines)


def _json(document: dict[str, Any]) -> str:
    def matrix(value: np.ndarray) -> dict[str, Any]:
        rows, columns = value.shape
        data = value.ravel().tolist()
        return {"type_id": "opencv-matrix", "rows": rows, "cols": columns, "dt": "d", "data": data}

    return json.dumps(document, default=matrix, indent=2, ensure_ascii=False) + "\n"
