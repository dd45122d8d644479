"""Cache of JAX's compiled kernels on disk, so that later processes start without compiling.

The command line enables the cache. A program enables it by `enable_compile_cache`; an import of the
package does not change the settings of JAX.
"""

import contextlib
import hashlib
import logging
import os
import platform
import stat
import sys
import warnings
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write
from trinoc.io.module_sources import digest_sources

LOGGER = logging.getLogger("trinoc")
COMPILE_CACHE_VARIABLE = "TRINOC_COMPILE_CACHE"
MOST_BYTES = 512 * 2**20


def enable_compile_cache(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """Store compiled kernels in a folder, so that later processes start without compiling.

    One call is enough, before or after the first compilation. The function sets JAX's persistent
    cache for the whole process, also for other packages. The folder is kept below 512 MiB.

    Parameters
    ----------
    folder : path, optional
        Folder, created with mode 0700 if missing. Default: the environment variable
        TRINOC_COMPILE_CACHE, which may also be "off"; without it, the user's cache folder.

    Returns
    -------
    Path or None
        The folder. None if the variable is "off". None also, with a warning in the log, if the
        folder cannot be created or if other users can write to it: kernels in the folder are
        executed.
    """
    folder_name = (
        os.environ.get(COMPILE_CACHE_VARIABLE, "") if folder is None else os.fspath(folder)
    )
    if folder is None and folder_name.lower() in ("off", "0", "no"):
        return None
    folder = Path(folder_name) if folder_name else _user_cache() / "trinoc" / "jax"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        private = _is_private(folder)
    except OSError as error:
        LOGGER.warning("no compile cache in %s (%s)", folder, error.strerror)
        return None
    if not private:
        LOGGER.warning(
            "no compile cache in %s, because others may write to it: chmod 700 it, or set %s",
            folder,
            COMPILE_CACHE_VARIABLE,
        )
        return None
    _forget_oldest(folder)

    import jax
    from jax.experimental.compilation_cache import compilation_cache

    from trinoc.numerics.programs import set_program_store

    # A kernel that another process is just writing is compiled once more, which is no news.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # JAX decides at its first compilation whether there is a cache: it is to decide anew.
    compilation_cache.reset_cache()
    set_program_store(FolderStore(folder))
    return folder


@contextlib.contextmanager
def compile_cache_for(task: str) -> Iterator[None]:
    """Context manager that enables the compile cache and loads programs in advance.

    These are the programs that the last run of the same task used.

    Parameters
    ----------
    task : str
        Name of the task, such as a command. The programs that this run uses are listed under it,
        for the next run.
    """
    from trinoc.numerics.programs import prefetch_programs, set_program_store

    folder = enable_compile_cache()
    if folder is None:
        yield
        return
    store = FolderStore(folder)
    set_program_store(store)
    try:
        with prefetch_programs(store.last_used(task)):
            yield
    finally:
        store.list_used(task)


def log_compiling(is_kept: bool, seconds: float) -> None:
    """Log a message that a program is being compiled.

    `seconds` is the time spent so far in this process. `is_kept` is True if a cache stores the
    result. Without a logging configuration, as in most scripts, the message goes to stderr.
    """
    if seconds > 0:
        message = f"still compiling: {seconds:.0f} s in this process so far"
    elif is_kept:
        message = (
            "compiling for this kind of input: this takes some seconds to two minutes, and only "
            "once"
        )
    else:
        message = (
            "compiling for the first calls of this process: this takes some seconds to two "
            "minutes; trinoc.io.enable_compile_cache() keeps the result for the next process"
        )
    if LOGGER.isEnabledFor(logging.INFO):
        LOGGER.info(message)
    elif LOGGER.level == logging.NOTSET and not LOGGER.hasHandlers():
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("trinoc: %(message)s"))
        no_location = "", 0
        handler.handle(
            LOGGER.makeRecord(LOGGER.name, logging.INFO, *no_location, message, (), None)
        )


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _is_private(folder: Path) -> bool:
    if sys.platform == "win32":
        return True  # folders in the user's profile are
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _forget_oldest(folder: Path) -> None:
    """Delete the oldest files until the folder is smaller than MOST_BYTES.

    JAX's own limit would need another package.
    """
    files = []
    with os.scandir(folder) as entries:  # twice as fast as Path.iterdir
        for entry in entries:
            # Another process may be doing the same.
            with contextlib.suppress(FileNotFoundError):
                if entry.is_file(follow_symlinks=False):
                    files.append((entry.stat(follow_symlinks=False), entry.path))
    size = sum(status.st_size for status, _ in files)
    if size <= MOST_BYTES:
        return
    for status, file in sorted(files, key=lambda pair: pair[0].st_mtime):
        if size <= MOST_BYTES:
            break
        # On Windows, another process may have it open.
        with contextlib.suppress(OSError):
            os.unlink(file)
        size -= status.st_size


LIBRARIES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "lineax", "jaxtyping")
_DIGEST_BYTES = 32


class FolderStore:
    """Folder of compiled programs: one file for each, with a checksum before the content."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._surroundings = ""
        # Programs read or written, in the order of their first use; the values mean nothing.
        self._used: dict[Path, None] = {}

    def get(self, name: str, modules: frozenset[str] = frozenset()) -> bytes | None:
        """Return the stored content of a program; None if it is missing or damaged.

        `modules` are the modules whose sources the program was compiled from. A change of a source
        makes the program unavailable.
        """
        try:
            path = self._place(name, modules)
            content = _read_whole(path)
        except (OSError, LookupError):
            return None
        if content is not None:
            self._used[path] = None
        return content

    def put(self, name: str, content: bytes, modules: frozenset[str] = frozenset()) -> None:
        """Store the content of a program; do nothing if the disk or the sources do not allow it.

        `modules` are the modules whose sources the program was compiled from.
        """
        with contextlib.suppress(OSError, InputError, LookupError):
            path = self._place(name, modules)
            with atomic_write(path) as file:
                file.write(hashlib.sha256(content).digest())
                file.write(content)
            self._used[path] = None

    def last_used(self, task: str) -> Iterator[bytes]:
        """Iterate over the contents of the programs that the last run of a task used, in order."""
        try:
            names = self._list(task).read_text(encoding="utf-8").split()
        except (OSError, ValueError):
            return
        for name in names:
            with contextlib.suppress(OSError):
                content = _read_whole(self._folder / Path(name).name)
                if content is not None:
                    yield content

    def list_used(self, task: str) -> None:
        """Write the list of the programs that this run has read or stored, for `last_used`."""
        if self._used:
            with contextlib.suppress(OSError, InputError), atomic_write(self._list(task)) as file:
                file.write("\n".join(path.name for path in tuple(self._used)).encode())

    def _list(self, task: str) -> Path:
        # A program of another version or processor must not even be loaded.
        return self._folder / f"trinoc-used-by-{task}-{self._environment()}"

    def _environment(self) -> str:
        """Return `surroundings()`, computed once: it costs some hundredths of a second."""
        self._surroundings = self._surroundings or surroundings()
        return self._surroundings

    def _place(self, name: str, modules: frozenset[str]) -> Path:
        key = f"{self._environment()} {digest_sources(modules)} {name}"
        digest = hashlib.sha256(key.encode()).hexdigest()
        return self._folder / f"trinoc-{digest}"


def _read_whole(path: Path) -> bytes | None:
    """Read the file of a program, without its checksum; None if the content is damaged."""
    content = path.read_bytes()
    # The youngest are kept when the folder grows too large.
    os.utime(path)
    digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def surroundings() -> str:
    """Digest of the conditions of every compiled program: versions, processor and settings."""
    import jax

    digest = hashlib.sha256()

    def take(*words: object) -> None:
        digest.update(repr(words).encode())

    for library in LIBRARIES:
        with contextlib.suppress(PackageNotFoundError):
            take(library, version(library))
    take(sys.version, platform.machine(), _processor())
    take([str(device) for device in jax.local_devices()], jax.default_backend())
    take(sorted((k, v) for k, v in os.environ.items() if k.startswith(("XLA_", "JAX_", "TF_"))))
    settings = {name: value for name, value in jax.config.values.items() if "cache" not in name}
    take(sorted((name, repr(value)) for name, value in settings.items()))
    return digest.hexdigest()


def _processor() -> str:
    """Model and instruction sets of the processor. A program for another one may not run here."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        kinds = ("model name", "flags", "Features", "CPU part")
        return repr(sorted({line for line in lines if line.startswith(kinds)}))
    return platform.processor()
