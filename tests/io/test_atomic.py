"""A file is whole or absent, and has the permissions of any new file."""

import stat

import pytest

from trinoc.errors import InputError
from trinoc.io import atomic_write, write_text


def test_failure_leaves_the_old_file_and_nothing_beside_it(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(KeyboardInterrupt):
        _write_half(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def _write_half(path):
    with atomic_write(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt


def test_new_content_replaces_the_old(tmp_path):
    path = tmp_path / "a.txt"
    for text in ("old", "new ü"):
        write_text(path, text)
    assert path.read_text(encoding="utf-8") == "new ü"
    assert list(tmp_path.iterdir()) == [path]


def test_permissions_are_those_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("")
    write_text(tmp_path / "whole", "")
    assert stat.S_IMODE((tmp_path / "whole").stat().st_mode) == stat.S_IMODE(
        (tmp_path / "plain").stat().st_mode
    )


def test_places_that_cannot_be_written_to(tmp_path):
    with pytest.raises(InputError, match="does not exist: create it first"):
        write_text(tmp_path / "none" / "a.txt", "")
    with pytest.raises(InputError, match="is a folder"):
        write_text(tmp_path, "")
