"""Settings of every test: double precision, no silent promotion, shapes checked at run time."""

import contextlib
import ctypes
import gc
import os
import random
from pathlib import Path

import jaxlib.version

# Threads of several test workers fight over the cores: one each, set before NumPy and OpenCV load.
for _variable in (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
):
    os.environ.setdefault(_variable, "1")

# Tests compile far longer than they compute: XLA's costly passes do not pay here. What users run,
# with these passes, is run by `.ci/run` in the demo. The code generator is the commands' own.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
# XLA ends the process for an option that it does not know, as versions from 0.12 on do.
if jaxlib.version.__version__.startswith("0.10."):
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")

# Workers, notebooks and the next run share what is compiled: programs are found by their sources.
# `pytest --cache-clear` forgets them.
_compiled = Path(__file__).parent.parent / ".pytest_cache" / "d" / "programs"
_compiled = Path(os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(_compiled)))
_compiled.mkdir(mode=0o700, parents=True, exist_ok=True)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

# Commands would take the user's own folder instead.
os.environ["TRINOC_COMPILE_CACHE"] = "off"

import hypothesis  # noqa: E402
import jax  # noqa: E402
import pytest  # noqa: E402

from tests import first_calls  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Before the first import of trinoc: its annotated shapes and dtypes are checked.
first_calls.install()

from trinoc.io.compile_cache import FolderStore  # noqa: E402
from trinoc.numerics.programs import forget_programs, set_program_store  # noqa: E402

# What one worker has traced, the other need not trace again.
set_program_store(FolderStore(_compiled))

# Compilation makes the first example slow, so a deadline would only measure the compiler. Where
# nobody waits to mend it, a failing example is told as it was drawn: shrinking takes minutes.
_phases = set(hypothesis.Phase)
if "CI" in os.environ:
    _phases -= {hypothesis.Phase.shrink, hypothesis.Phase.explain}
hypothesis.settings.register_profile(
    "trinoc",
    derandomize=True,
    deadline=None,
    max_examples=50,
    phases=_phases,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("trinoc")

# More would wait for the longest tests, and each takes more than 1 GB.
MOST_WORKERS = 8
# Bytes, of which programs take most, hundreds of small ones as much as a large one. Beyond, they
# are forgotten between files of tests.
MOST_MEMORY = 1_300_000_000


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """`pytest` alone runs on all cores; with files or folders named, in this one process."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    if config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return 0
    return min(os.cpu_count() or 1, MOST_WORKERS)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Seed the generator with which beartype picks the member of a container that it checks."""
    random.seed(item.nodeid)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """After a file of tests, free the compiled programs if the process uses much memory."""
    is_last = nextitem is None or nextitem.path != item.path
    if is_last:
        first_calls.begin_file()
    if is_last and memory_in_use() > MOST_MEMORY:
        forget_what_was_compiled()


def pytest_collection_finish() -> None:
    """Free the memory that importing left, and exclude imported objects from garbage collection."""
    gc.collect()
    gc.freeze()
    return_free_memory()


def memory_in_use() -> float:
    """Bytes that this process holds; infinitely many where the system does not say."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        return float(pages) * os.sysconf("SC_PAGE_SIZE")
    return float("inf")


def forget_what_was_compiled() -> None:
    """Free the memory of all compiled programs. The shared folder still has them."""
    forget_programs()
    return_free_memory()


def return_free_memory() -> None:
    """Return free memory to the system."""
    with contextlib.suppress(AttributeError, OSError, TypeError):  # of the GNU C library alone
        ctypes.CDLL(None).malloc_trim(0)
