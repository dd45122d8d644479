"""Settings of every test: double precision, no silent promotion, shapes checked at run time."""

import atexit
import os
import shutil
import tempfile

# LAPACK threads of several test workers fight over the cores: one each, set before NumPy loads.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

# Tests compile far longer than they compute: XLA's costly passes do not pay here. What users run,
# with these passes, is run by `.ci/run` in the demo.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")

# Workers and notebooks compile the same kernels. They share them through a folder that the
# first process makes and removes; the others find its name in their environment.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _compiled = tempfile.mkdtemp(prefix="trinoc-tests-")
    atexit.register(shutil.rmtree, _compiled, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _compiled
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

import hypothesis  # noqa: E402
import jax  # noqa: E402
import jaxtyping  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Before the first import of trinoc: its annotated shapes and dtypes are checked on every call.
# The numeric tower lets 16 stand where a float is annotated, as every type checker does.
jaxtyping.install_import_hook(
    "trinoc", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"
)

# Compilation makes the first example slow, so a deadline would only measure the compiler.
hypothesis.settings.register_profile(
    "trinoc",
    derandomize=True,
    deadline=None,
    max_examples=50,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("trinoc")
