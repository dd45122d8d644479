"""Programs of `trinoc.numerics.kept_jit` in the folder of compiled kernels.

A program is found by its own name and by all else that it depends on: trinoc's sources, the
versions of the libraries that it was traced and compiled with, the processor, and the settings of
JAX and XLA.
"""

import contextlib
import hashlib
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write

LIBRARIES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "lineax", "jaxtyping")
# Where programs are made, and all that these rooms may import: `tests/test_floors.py` holds it.
ROOMS = ("numerics", "geometry", "image", "calib", "match")
_DIGEST_BYTES = 32


class FolderStore:
    """Programs as files, each with the digest of its content before it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._surroundings = ""

    def get(self, name: str) -> bytes | None:
        """The content, if it is there and whole."""
        place = self._place(name)
        try:
            content = place.read_bytes()
            # The youngest are kept when the folder grows too large.
            os.utime(place)
        except OSError:
            return None
        digest, content = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        return content if hashlib.sha256(content).digest() == digest else None

    def put(self, name: str, content: bytes) -> None:
        """Keep it where the disk allows."""
        with contextlib.suppress(OSError, InputError), atomic_write(self._place(name)) as file:
            file.write(hashlib.sha256(content).digest())
            file.write(content)

    def _place(self, name: str) -> Path:
        # Only where a program is asked for: it costs some hundredths of a second.
        self._surroundings = self._surroundings or surroundings()
        digest = hashlib.sha256(f"{self._surroundings} {name}".encode()).hexdigest()
        return self._folder / f"trinoc-{digest}"


def surroundings() -> str:
    """A digest of everything outside its arguments that a compiled program depends on."""
    import jax

    found = hashlib.sha256()

    def take(*words: object) -> None:
        found.update(repr(words).encode())

    root = Path(__file__).parent.parent
    for room in ROOMS:
        for path in sorted((root / room).rglob("*.py")):
            take(str(path.relative_to(root)))
            found.update(path.read_bytes())
    for library in LIBRARIES:
        with contextlib.suppress(PackageNotFoundError):
            take(library, version(library))
    take(sys.version, platform.machine(), _processor())
    take([str(device) for device in jax.local_devices()], jax.default_backend())
    take(sorted((k, v) for k, v in os.environ.items() if k.startswith(("XLA_", "JAX_", "TF_"))))
    settings = {name: value for name, value in jax.config.values.items() if "cache" not in name}
    take(sorted((name, repr(value)) for name, value in settings.items()))
    return found.hexdigest()


def _processor() -> str:
    """What the processor can do: a program for another may not run here."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        kinds = ("model name", "flags", "Features", "CPU part")
        return repr(sorted({line for line in lines if line.startswith(kinds)}))
    return platform.processor()
