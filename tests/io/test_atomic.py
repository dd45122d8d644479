"""A file is whole or absent, and has the permissions of any new file."""

import os
import re
import stat
import time

import numpy as np
import pytest

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write, expect_place, write_text
from trinoc.io.frames_files import save_frames
from trinoc.recording.frame_table import FrameMatches


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


@pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")
def test_a_folder_that_takes_no_files_is_told_before_the_work(tmp_path, monkeypatch):
    # Permissions do not bind the superuser, whom tests may run as.
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    with pytest.raises(InputError, match=r"rig\.json cannot be written"):
        expect_place(tmp_path / "rig.json")


def test_a_link_stays_and_what_it_names_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "real.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    link.unlink()
    link.symlink_to(tmp_path / "none" / "a.txt")
    with pytest.raises(InputError, match="does not exist: create it first"):
        write_text(link, "")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="is a device or a pipe"):
        write_text(tmp_path / "pipe", "")


def test_what_a_killed_program_left_is_swept_and_nothing_else(tmp_path):
    old = time.time() - 2 * 3600
    names = [".a.txt.0123abcd.tmp", ".b.txt.0123abcd.tmp", ".a.txt.short.tmp", "a.txt.0123abcd.tmp"]
    for name in names:
        (tmp_path / name).write_text("half")
        os.utime(tmp_path / name, (old, old))
    (tmp_path / ".a.txt.11112222.tmp").write_text("another program is writing this")
    write_text(tmp_path / "a.txt", "whole")
    remaining = {path.name for path in tmp_path.iterdir()}
    assert remaining == {"a.txt", ".a.txt.11112222.tmp", *names[1:]}


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
@pytest.mark.parametrize("written", ["text", "npz", "parquet"])
def test_where_the_disk_takes_no_more_the_file_is_named_and_the_old_one_stays(tmp_path, written):
    import resource

    path = tmp_path / f"a.{written}"
    path.write_text("old")
    views = ("upper", "left")
    # Incompressible, so that nothing makes it fit.
    name = "".join(map(chr, np.random.default_rng(1).integers(0x4E00, 0x9000, 20_000)))
    results = [FrameMatches(name, "failed.", None)]
    if written == "parquet":
        pytest.importorskip("pyarrow")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, hard))
    try:
        with pytest.raises(InputError, match=re.escape(f"{path} was not written (File too large)")):
            write_text(path, name) if written == "text" else save_frames(results, views, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
