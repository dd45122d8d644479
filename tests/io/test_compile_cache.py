"""The compile cache is private, bounded, and can be switched off."""

import contextlib
import logging
import os
import stat

import jax
import pytest
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from trinoc.cli.command import set_up_logging
from trinoc.io import compile_cache
from trinoc.io.compile_cache import (
    COMPILE_CACHE_VARIABLE,
    LOGGER,
    FolderStore,
    enable_compile_cache,
    log_compiling,
    surroundings,
)
from trinoc.numerics import compile_notice
from trinoc.numerics.programs import set_program_store

SETTINGS = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)


def cache_dir():
    return getattr(jax.config, SETTINGS[0])


@pytest.fixture(autouse=True)
def _settings_as_before():
    before = {name: getattr(jax.config, name) for name in SETTINGS}
    store = set_program_store(None)
    yield
    set_program_store(store)
    for name, value in before.items():
        jax.config.update(name, value)
    reset_cache()


def test_folder_given_holds_what_compiles_from_then_on(tmp_path, monkeypatch):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, "off")
    jax.jit(lambda x: x + 1)(1.0)
    assert enable_compile_cache(tmp_path / "kernels") == tmp_path / "kernels"
    jax.jit(lambda x: x - 2)(1.0)
    assert list((tmp_path / "kernels").iterdir())


def test_folder_is_made_for_the_user_alone(tmp_path, monkeypatch):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, str(tmp_path / "a" / "b"))
    assert enable_compile_cache() == tmp_path / "a" / "b"
    assert stat.S_IMODE((tmp_path / "a" / "b").stat().st_mode) == 0o700
    assert cache_dir() == str(tmp_path / "a" / "b")


def test_default_is_the_user_s_cache_folder(tmp_path, monkeypatch):
    monkeypatch.delenv(COMPILE_CACHE_VARIABLE, raising=False)
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    folder = enable_compile_cache()
    assert folder is not None
    assert folder.is_relative_to(tmp_path)


@pytest.mark.parametrize("value", ["off", "OFF", "0", "no"])
def test_off(monkeypatch, value):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, value)
    before = cache_dir()
    assert enable_compile_cache() is None
    assert cache_dir() == before


def test_folder_that_others_may_write_to_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, str(tmp_path))
    tmp_path.chmod(0o770)
    before = cache_dir()
    assert enable_compile_cache() is None
    assert cache_dir() == before


def test_folder_that_cannot_be_made_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, str(tmp_path / "file"))
    assert enable_compile_cache() is None


def test_oldest_kernels_go_first(tmp_path, monkeypatch):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setattr(compile_cache, "MOST_BYTES", 250)
    for age, name in enumerate("dcba"):
        (tmp_path / name).write_bytes(b"x" * 100)
        os.utime(tmp_path / name, (1000 - age, 1000 - age))
    enable_compile_cache()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c", "d"]


@pytest.mark.parametrize(
    "poison",
    [lambda b: b"", lambda b: b"poison" * 50, lambda b: b[: len(b) // 2], lambda b: b[::-1]],
)
def test_entries_that_are_damaged_change_no_answer(tmp_path, poison):
    enable_compile_cache(tmp_path / "kernels")

    def answers():
        jax.clear_caches()
        return float(jax.jit(lambda x: 3 * x - 1)(5.0))

    assert answers() == 14.0
    entries = [path for path in (tmp_path / "kernels").iterdir() if path.name.endswith("-cache")]
    assert entries
    for entry in entries:
        entry.write_bytes(poison(entry.read_bytes()))
    assert answers() == 14.0


def test_a_kernel_that_another_process_has_just_removed_is_no_error(tmp_path, monkeypatch):
    for name in "ab":
        (tmp_path / name).write_bytes(b"x")
    scandir = os.scandir

    @contextlib.contextmanager
    def scan_while_another_removes(folder):
        with scandir(folder) as entries:
            entries = list(entries)
        (tmp_path / "a").unlink()
        yield entries

    monkeypatch.setattr(os, "scandir", scan_while_another_removes)
    assert enable_compile_cache(tmp_path) == tmp_path


def test_a_program_comes_back_whole_or_not_at_all(tmp_path):
    store = FolderStore(tmp_path)
    assert store.get("a") is None
    store.put("a", b"program")
    assert FolderStore(tmp_path).get("a") == b"program"
    assert store.get("b") is None
    (file,) = tmp_path.iterdir()
    for damage in (b"", b"short", file.read_bytes()[:-1], file.read_bytes() + b"x"):
        file.write_bytes(damage)
        assert store.get("a") is None


def test_the_programs_of_the_last_run_are_listed_in_the_order_of_their_use(tmp_path):
    store = FolderStore(tmp_path)
    for name in "abc":
        store.put(name, name.encode())
    run = FolderStore(tmp_path)
    for name in "cab":
        run.get(name)
    run.list_used("calibrate")
    assert list(FolderStore(tmp_path).last_used("calibrate")) == [b"c", b"a", b"b"]
    assert not list(FolderStore(tmp_path).last_used("match"))
    # A run that compiled nothing does not shorten the list.
    FolderStore(tmp_path).list_used("calibrate")
    assert len(list(FolderStore(tmp_path).last_used("calibrate"))) == 3


def test_programs_of_another_version_are_not_listed(tmp_path, monkeypatch):
    store = FolderStore(tmp_path)
    store.put("a", b"program")
    store.list_used("match")
    assert list(FolderStore(tmp_path).last_used("match")) == [b"program"]
    monkeypatch.setattr("trinoc.io.compile_cache.version", lambda name: "99")
    assert not list(FolderStore(tmp_path).last_used("match"))


@pytest.mark.parametrize("text", [b"", b"\xff\x00", b"../outside", b"a\nmissing", b"."])
def test_a_damaged_list_of_programs_names_none(tmp_path, text):
    # A complete program beside the folder: only its position makes it unusable.
    FolderStore(tmp_path).put("a", b"program")
    next(tmp_path.iterdir()).rename(tmp_path / "outside")
    folder = tmp_path / "cache"
    folder.mkdir()
    FolderStore(folder)._list("match").write_bytes(text)
    assert not list(FolderStore(folder).last_used("match"))


def test_a_folder_that_is_gone_is_done_without(tmp_path):
    store = FolderStore(tmp_path / "gone")
    store.put("a", b"program")
    assert store.get("a") is None


def test_a_program_is_not_found_after_anything_changed(tmp_path, monkeypatch):
    FolderStore(tmp_path).put("a", b"program")
    before = surroundings()
    assert surroundings() == before
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    assert surroundings() != before
    assert FolderStore(tmp_path).get("a") is None
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    monkeypatch.setattr("trinoc.io.compile_cache.version", lambda name: "99")
    assert surroundings() != before


def test_a_program_of_a_module_without_source_is_not_kept(tmp_path):
    store = FolderStore(tmp_path)
    store.put("a", b"program", frozenset({"no_module"}))
    assert store.get("a", frozenset({"no_module"})) is None
    assert not list(tmp_path.iterdir())
    store.put("a", b"program", frozenset({"trinoc.match.matcher"}))
    assert store.get("a", frozenset({"trinoc.match.matcher"})) == b"program"
    assert store.get("a", frozenset({"trinoc.cli.main"})) is None


@pytest.fixture
def nobody_configured_logging(monkeypatch):
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    monkeypatch.setattr(LOGGER, "handlers", [])
    monkeypatch.setattr(LOGGER, "propagate", True)
    before = LOGGER.level
    LOGGER.setLevel(logging.NOTSET)
    yield logging.getLogger()
    LOGGER.setLevel(before)


@pytest.mark.parametrize("is_kept", [True, False])
def test_a_script_that_configures_no_logging_reads_once_that_it_waits(
    nobody_configured_logging, capsys, is_kept
) -> None:
    nobody_configured_logging.handlers.clear()  # pytest's own
    log_compiling(is_kept, 0.0)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("trinoc: compiling")
    # What could be kept, and is not, comes with what to do about it.
    assert ("enable_compile_cache" in line) == (not is_kept)


@pytest.mark.parametrize(("level", "lines"), [(logging.INFO, 1), (logging.WARNING, 0)])
def test_a_script_that_configures_logging_reads_what_it_asked_for(
    nobody_configured_logging, capsys, monkeypatch, level, lines
) -> None:
    root = nobody_configured_logging
    root.handlers[:] = [logging.StreamHandler()]
    monkeypatch.setattr(root, "level", level)
    LOGGER.manager._clear_cache()  # pyright: ignore[reportAttributeAccessIssue]
    log_compiling(True, 0.0)
    assert len(capsys.readouterr().err.splitlines()) == lines


@pytest.mark.parametrize("quiet", [True, False])
def test_a_command_says_once_that_it_compiles_and_nothing_where_it_is_quiet(
    nobody_configured_logging, capsys, quiet
) -> None:
    set_up_logging(quiet=quiet)
    log_compiling(True, 0.0)
    assert len(capsys.readouterr().err.splitlines()) == 1 - quiet


def test_what_compiles_for_long_is_told_again(monkeypatch) -> None:
    notices = []
    monkeypatch.setattr(
        compile_notice, "_notices", [lambda is_cached, seconds: notices.append(seconds)]
    )
    monkeypatch.setattr(compile_notice, "_seconds", [0.0])
    monkeypatch.setattr(compile_notice, "_next_at", [0.0])
    moments = iter([0.0, 20.0, 20.0, 45.0, 45.0, 50.0, 50.0, 80.0])
    monkeypatch.setattr(compile_notice.time, "monotonic", lambda: next(moments))
    for _ in range(4):
        with compile_notice.compiling():
            pass
    assert notices == [0.0, 45.0]
