"""Compiled programs: compiled by one thread only, and kept for the next process.

JAX's own cache keeps what was compiled, but finds it by the traced and lowered program: a process
that computes for a tenth of a second traces for ten. Programs that `kept_jit` makes are found by
what they are made from: the function, its static arguments, the kinds of its arrays, and,
through the store, everything else that could change them. Without a store (`set_program_store`),
inside `jit`, `grad` or `vmap`, and with values of classes that are not trinoc's, they are plain
`jax.jit`.
"""

import contextlib
import functools
import hashlib
import inspect
import pickle
import re
import secrets
import threading
from collections.abc import Callable, Hashable, Iterator
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from trinoc.numerics.buckets import FEW_ROWS
from trinoc.numerics.compile_notice import compiling, notice_compiling
from trinoc.numerics.compiler_options import quick_compiling
from trinoc.numerics.forked import expect_no_fork, note_computation
from trinoc.numerics.precision import as_numpy, is_outside, is_traced

# Whose classes a version number or the store's own key stands for.
_KNOWN = {
    *("trinoc", "jax", "jaxlib", "jaxtyping", "numpy", "equinox", "optimistix", "lineax"),
    *("builtins", "collections", "functools"),
}
# Beginning of the names by which compiled programs call LAPACK.
_LAPACK = "lapack_"
# numerical: arguments of fewer numbers, as of some 200 segments a view, are worked through in
# milliseconds.
OPTIMIZED_FROM = 1 << 16
_compiling = threading.Lock()
_compiled: set[Hashable] = set()


def count_numbers(values: Any) -> int:
    """Of all arrays in a tree."""
    return sum(np.size(leaf) for leaf in jax.tree.leaves(values))


@contextlib.contextmanager
def one_compiles(*program: Hashable) -> Iterator[None]:
    """Hold a block that calls a jitted program until another thread has compiled the same.

    Threads that meet an uncompiled program would each compile it, in time and memory of their own.

    program : all in which it differs from others: its name, static arguments and shapes.
    """
    if program in _compiled:
        yield
        return
    with _compiling:
        yield
        _compiled.add(program)


@runtime_checkable
class ProgramStore(Protocol):
    """Where programs are kept. Content comes back as it was put, or not at all.

    `modules` are the names of the modules from which the content is made: it is not returned after
    the source of one of them, or of a module that they import, has changed.
    """

    def get(self, name: str, modules: frozenset[str] = frozenset()) -> bytes | None:
        """The content that was put under the name, on this machine."""
        ...

    def put(self, name: str, content: bytes, modules: frozenset[str] = frozenset()) -> None:
        """Keep it, or do without."""
        ...


class _KeptProgram(NamedTuple):
    """A program on flat lists of arrays, and the shape of what it returns."""

    program: Callable[[list[Any]], list[Any]]
    result: Any


# The store, if there is one, and what each kept function has loaded from it.
_stores: list[ProgramStore | None] = [None]
_loaded: list[dict[Hashable, _KeptProgram | None]] = []


def set_program_store(store: ProgramStore | None) -> ProgramStore | None:
    """Use a store from now on, or none; returns the one before."""
    before, _stores[0] = _stores[0], store
    return before


def forget_programs() -> None:
    """Give the memory of all programs back, `jax.jit`'s too; the store still has its own."""
    for programs in _loaded:
        programs.clear()
    jax.clear_caches()


def kept_jit(
    function: Callable[..., Any],
    *,
    static_argnames: tuple[str, ...] = (),
    optimized_from: int = OPTIMIZED_FROM,
    few_rows_of: str | None = None,
) -> Callable[..., Any]:
    """`jax.jit` of a function without side effects, whose programs a store may keep.

    The function must take no value from outside but constants of trinoc's own modules. For
    arguments of fewer numbers than `optimized_from` it is not optimized: compiling would take
    longer than the program ever runs. Array code (`array_namespace`) is not compiled at all where
    the argument `few_rows_of` has FEW_ROWS at most: NumPy runs it as it is.
    """
    # Options of the compiler are for whole programs alone.
    inner = jax.jit(function, static_argnames=static_argnames)
    options = {
        optimized: quick_compiling(optimized=optimized) or None for optimized in (False, True)
    }
    whole = {
        optimized: jax.jit(function, static_argnames=static_argnames, compiler_options=own)
        for optimized, own in options.items()
    }
    signature = inspect.signature(function)
    caller = _calling_module()
    known: dict[Hashable, _KeptProgram | None] = {}
    _loaded.append(known)

    def choose_jit(args: Any, kwargs: Any) -> Callable[..., Any]:
        return whole[count_numbers((args, kwargs)) >= optimized_from]

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        store = _stores[0]
        config: Any = jax.config
        if is_traced(args, kwargs) or not is_outside():
            return inner(*args, **kwargs)
        expect_no_fork()
        if few_rows_of is not None:
            given = signature.bind(*args, **kwargs)
            if len(given.arguments[few_rows_of]) <= FEW_ROWS:
                with np.errstate(all="ignore"):
                    return function(*as_numpy(args), **kwargs)
        note_computation()
        if store is None or config.jax_disable_jit or jax.default_backend() != "cpu":
            notice_compiling(is_kept=False)
            return choose_jit(args, kwargs)(*args, **kwargs)
        given = signature.bind(*args, **kwargs)
        given.apply_defaults()
        static = {name: given.arguments.pop(name) for name in static_argnames}
        leaves, tree = jax.tree.flatten(dict(given.arguments))
        kinds = tuple(jax.api_util.shaped_abstractify(leaf) for leaf in leaves)
        precision = (config.jax_enable_x64, config.jax_default_matmul_precision)
        key = (tree, kinds, tuple(static.values()), precision)
        if key not in known:
            own = options[count_numbers(leaves) >= optimized_from]
            known[key] = _load_or_compile(store, function, caller, static, tree, leaves, key, own)
        kept = known[key]
        if kept is None:
            return choose_jit(args, kwargs)(*args, **kwargs)
        return jax.tree.unflatten(kept.result, kept.program(leaves))

    return call


def _calling_module() -> str:
    """The module of trinoc that calls `kept_jit` while it is imported, or an empty name.

    Its source is part of the program: it says what `vmap` maps over, for one.
    """
    frame = inspect.currentframe()
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if frame.f_code.co_name == "<module>" and module.startswith("trinoc."):
            return module
        frame = frame.f_back
    return ""


def _load_or_compile(
    store: ProgramStore,
    function: Callable[..., Any],
    caller: str,
    static: dict[str, Any],
    tree: Any,
    leaves: list[Any],
    key: tuple[Hashable, ...],
    options: dict[str, str | bool] | None,
) -> _KeptProgram | None:
    """The program, from the store or compiled and put there; None where it cannot be kept."""
    from jax.experimental import serialize_executable

    in_tree = jax.tree.structure(((leaves,), {}))
    try:
        name, modules = _name(function, caller, key)
    except (pickle.PicklingError, TypeError, AttributeError):
        return None
    content = store.get(name, modules)
    if content is not None:
        try:
            payload, like, with_lapack = pickle.loads(content)
            if with_lapack:
                _make_lapack_ready()
            values, result = jax.tree.flatten(like)
            out_tree = jax.tree.structure(values)
            return _KeptProgram(
                serialize_executable.deserialize_and_load(payload, in_tree, out_tree), result
            )
        except Exception:
            pass
    found: list[Any] = []

    def flat(leaves: list[Any]) -> list[Any]:
        values, result = jax.tree.flatten(function(**jax.tree.unflatten(tree, leaves), **static))
        found[:] = [result]
        return values

    # What JAX's own cache hands out cannot be kept again: a name of its own, so that it compiles.
    flat.__name__ = f"{function.__name__}_{secrets.token_hex(4)}"
    with compiling():
        compiled = jax.jit(flat).lower(leaves).compile(compiler_options=options)
    result = found[0]
    try:
        # What a program calls must be there when it is loaded.
        calls = set(re.findall(r'custom_call_target="([^"]*)"', compiled.as_text() or ""))
        if all(call.startswith(_LAPACK) for call in calls):
            # A value of the result's kind and not its tree, whose marks do not survive pickling.
            like = jax.tree.unflatten(result, range(result.num_leaves))
            payload = serialize_executable.serialize(compiled)[0]
            store.put(name, _pickle_own_classes((payload, like, bool(calls)))[0], modules)
    except Exception:
        pass
    return _KeptProgram(compiled, result)


@functools.cache
def _make_lapack_ready() -> None:
    """JAX looks LAPACK's addresses up when it first lowers a call; a loaded program does not."""
    jax.jit(jnp.linalg.cholesky).lower(np.eye(2))


def _name(
    function: Callable[..., Any], caller: str, key: tuple[Hashable, ...]
) -> tuple[str, frozenset[str]]:
    """A name that differs where the function or its arguments differ, and the modules of both.

    A class of an argument brings its module: the function may know only its base class.
    """
    tree, kinds, *rest = key
    kinds = [(k.shape, str(k.dtype), k.weak_type) for k in kinds]  # pyright: ignore
    made_of = (function.__module__, function.__qualname__, tree, kinds, rest)
    content, modules = _pickle_own_classes(made_of)
    own = {function.__module__, caller} - {""}
    return hashlib.sha256(content).hexdigest(), frozenset(modules | own)


class _OwnClasses(pickle.Pickler):
    """Refuses values whose class may change without trinoc's knowing, such as a user's own lens;
    collects the modules of trinoc whose classes and functions it meets."""

    def __init__(self, parts: "_Parts") -> None:
        super().__init__(parts, protocol=5)
        self.modules: set[str] = set()

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, type) or inspect.isroutine(value):
            module = getattr(value, "__module__", "") or ""
            room = module.partition(".")[0]
            if room not in _KNOWN:
                raise pickle.PicklingError(f"{value} is not of trinoc")
            if room == "trinoc":
                self.modules.add(module)
        return NotImplemented


class _Parts(list[bytes]):
    """What a pickler writes to: `io` stands above this floor."""

    def write(self, part: bytes) -> None:
        self.append(bytes(part))


def _pickle_own_classes(value: Any) -> tuple[bytes, set[str]]:
    """(content, the modules of trinoc whose classes and functions it names)."""
    parts = _Parts()
    pickler = _OwnClasses(parts)
    pickler.dump(value)
    return b"".join(parts), pickler.modules
