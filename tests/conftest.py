"""Settings of every test: double precision, no silent promotion, shapes checked at run time."""

import os

# LAPACK threads of several test workers fight over the cores: one each, set before NumPy loads.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

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
