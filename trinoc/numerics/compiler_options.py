"""XLA options that shorten compiling without slower programs.

Read before JAX loads, so this file does not import it.
"""

import jaxlib.version

# MLIR fusion emitters: programs are no faster, compiling takes 50 % longer. Parallel code
# generation: 10 % more processor time and twice as many memory mappings.
_QUICKER: dict[str, str | bool] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": "1",
}
# Halves the compile time; programs of milliseconds take a third longer.
_UNOPTIMIZED: dict[str, str | bool] = {"xla_backend_optimization_level": "0"}
# XLA raises an error for unknown options: versions that were tested.
_TESTED_VERSIONS = ("0.10.",)


def quick_compiling(*, optimized: bool = True) -> dict[str, str | bool]:
    """Options of the XLA compiler that shorten the compilation.

    Parameters
    ----------
    optimized : bool
        True for options that do not slow down the program. False for further options, for programs
        that run for milliseconds only.

    Returns
    -------
    dict
        Empty for a version of jaxlib that was not tested.
    """
    if not jaxlib.version.__version__.startswith(_TESTED_VERSIONS):
        return {}
    return _QUICKER | ({} if optimized else _UNOPTIMIZED)
