"""What the commands tell JAX's compiler before JAX loads."""

import os


def compile_quickly() -> None:
    """Choose the quicker of XLA's code generators, unless the user's XLA_FLAGS name one."""
    from trinoc.numerics import quick_compiling

    own = os.environ.get("XLA_FLAGS", "")
    flags = [
        f"--{name}={str(value).lower()}"
        for name, value in quick_compiling().items()
        if name not in own
    ]
    if flags:
        os.environ["XLA_FLAGS"] = " ".join([*flags, own]).rstrip()
