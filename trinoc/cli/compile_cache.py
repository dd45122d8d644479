"""JAX's compiled kernels kept between runs, so that the second command starts at once.

Only the command line and notebooks switch this on: whoever imports the package keeps the JAX
settings they chose.
"""

import os
import stat
import sys
import warnings
from pathlib import Path

from trinoc.cli.progress import LOGGER

VARIABLE = "TRINOC_COMPILE_CACHE"
MOST_BYTES = 512 * 2**20


def enable_compile_cache() -> Path | None:
    """Keep compiled kernels in a folder that only this user can write to; returns it.

    The environment variable TRINOC_COMPILE_CACHE names another folder, or is "off". Returns
    None, after a warning, where the folder cannot be made or others could write to it:
    the kernels in it are executed.
    """
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() in ("off", "0", "no"):
        return None
    folder = Path(wanted) if wanted else _user_cache() / "trinoc" / "jax"
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
            VARIABLE,
        )
        return None
    _forget_oldest(folder)

    import jax

    # A kernel that another process is just writing is compiled once more, which is no news.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return folder


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
    """Keep the folder under MOST_BYTES. JAX can, too, but only with a further package."""
    files = [(file.stat(), file) for file in folder.iterdir() if file.is_file()]
    size = sum(status.st_size for status, _ in files)
    for status, file in sorted(files, key=lambda pair: pair[0].st_mtime):
        if size <= MOST_BYTES:
            break
        file.unlink(missing_ok=True)
        size -= status.st_size
