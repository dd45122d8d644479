"""Compiled programs: each compiled by one thread only, and stored for later processes.

JAX's own cache stores compiled programs but keys them by the traced and lowered program. A process
that computes for 0.1 s then traces for 10 s. Programs of `kept_jit` have a key from their sources:
the function, its static arguments, the kinds of its arrays, and through the store everything else
that could change them. They are plain `jax.jit` in three cases: without a store
(`set_program_store`), inside `jit`, `grad` or `vmap`, and for values of classes that are not
trinoc's.
"""

import contextlib
import functools
import hashlib
import inspect
import pickle
import re
import secrets
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from trinoc.numerics.buckets import FEW_ROWS
from trinoc.numerics.compile_notice import compiling, notice_compiling
from trinoc.numerics.compiler_options import quick_compiling
from trinoc.numerics.forked import expect_no_fork, note_computation
from trinoc.numerics.precision import as_numpy, is_outside, is_traced

# Packages whose classes are identified by a version number or by the store's own key.
_KNOWN = {
    *("trinoc", "jax", "jaxlib", "jaxtyping", "numpy", "equinox", "optimistix", "lineax"),
    *("builtins", "collections", "functools"),
}
# Prefix of LAPACK's names in compiled programs.
_LAPACK = "lapack_"
# numerical: programs on fewer array entries, such as 200 segments per view, take milliseconds.
OPTIMIZED_FROM = 1 << 16
_compiling = threading.Lock()
_compiled: set[Hashable] = set()


def count_numbers(values: Any) -> int:
    """Total number of entries of all arrays in a tree."""
    return sum(np.size(leaf) for leaf in jax.tree.leaves(values))


@contextlib.contextmanager
def compile_once(*program: Hashable) -> Iterator[None]:
    """Context for a call of a jitted function: one thread compiles it while other threads wait.

    Without this context, every thread that calls a program before its compilation would compile it,
    with its own time and memory.

    Parameters
    ----------
    program : hashable
        Everything that distinguishes the compiled program: name, static arguments and shapes.
    """
    if program in _compiled:
        yield
        return
    with _compiling:
        yield
        _compiled.add(program)


@runtime_checkable
class ProgramStore(Protocol):
    """Interface of a storage for compiled programs.

    The storage returns a content exactly as it was stored, or None. The argument `modules` contains
    the names of the modules on which the content depends. After a change in the source of one of
    these modules, or of a module that one of them imports, the content is not returned.
    """

    def get(self, name: str, modules: frozenset[str] = frozenset()) -> bytes | None:
        """Return the content that is stored under the name on this machine, or None."""
        ...

    def put(self, name: str, content: bytes, modules: frozenset[str] = frozenset()) -> None:
        """Store the content under the name. A failure is not an error."""
        ...


class _KeptProgram(NamedTuple):
    """A compiled program.

    Attributes
    ----------
    program : callable
        Function of a list of arrays that returns a list of arrays.
    result : tree structure
        Structure of the result, into which the list of arrays is converted.
    """

    program: Callable[[list[Any]], list[Any]]
    result: Any


class _StoredProgram(NamedTuple):
    """Content of the program store for one compiled program, before it is pickled.

    Attributes
    ----------
    executable : bytes
        The compiled program, as JAX serializes it.
    inputs, outputs : int
        Numbers of arrays that the program has as arguments and as results.
    result : bytes
        Pickled value whose tree structure is that of the function's result, because a structure
        itself cannot be pickled.
    uses_lapack : bool
        True if the program calls LAPACK.
    """

    executable: bytes
    inputs: int
    outputs: int
    result: bytes
    uses_lapack: bool


# The store, if any, and the programs that each kept function has loaded from it.
_stores: list[ProgramStore | None] = [None]
_loaded: list[dict[Hashable, _KeptProgram | None]] = []
# Executables that a thread loads, by the content of the store.
_prefetched: dict[bytes, Future[Callable[[list[Any]], list[Any]]]] = {}


def set_program_store(store: ProgramStore | None) -> ProgramStore | None:
    """Set the storage for compiled programs, and return the previous storage.

    Parameters
    ----------
    store : ProgramStore, optional
        The storage; None for no storage.
    """
    before, _stores[0] = _stores[0], store
    return before


def forget_programs() -> None:
    """Free the memory of all compiled programs, including those of `jax.jit`.

    Stored copies remain.
    """
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
    """Like `jax.jit`, with compiled programs that are stored for later processes.

    Parameters
    ----------
    function : callable
        Function without side effects. It must depend only on its arguments and on constants of
        trinoc's modules.
    static_argnames : tuple of str
        As in `jax.jit`.
    optimized_from : int
        Number of array entries in the arguments from which the program is optimized. With fewer
        entries, the optimization would take longer than the program ever runs.
    few_rows_of : str, optional
        Name of an argument. If it has at most FEW_ROWS rows, code based on `array_namespace` runs
        in NumPy without a compilation.
    """
    # Compiler options apply to outermost programs only.
    inner = jax.jit(function, static_argnames=static_argnames)
    options = {
        optimized: quick_compiling(optimized=optimized) or None for optimized in (False, True)
    }
    outer_jit = {
        optimized: jax.jit(
            function, static_argnames=static_argnames, compiler_options=compiler_options
        )
        for optimized, compiler_options in options.items()
    }
    signature = inspect.signature(function)
    caller = _calling_module()
    programs: dict[Hashable, _KeptProgram | None] = {}
    _loaded.append(programs)

    def choose_jit(args: Any, kwargs: Any) -> Callable[..., Any]:
        return outer_jit[count_numbers((args, kwargs)) >= optimized_from]

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        store = _stores[0]
        config: Any = jax.config
        if is_traced(args, kwargs) or not is_outside():
            return inner(*args, **kwargs)
        expect_no_fork()
        if few_rows_of is not None:
            bound = signature.bind(*args, **kwargs)
            if len(bound.arguments[few_rows_of]) <= FEW_ROWS:
                with np.errstate(all="ignore"):
                    return function(*as_numpy(args), **kwargs)
        note_computation()
        if store is None or config.jax_disable_jit or jax.default_backend() != "cpu":
            notice_compiling(is_kept=False)
            return choose_jit(args, kwargs)(*args, **kwargs)
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        static = {name: bound.arguments.pop(name) for name in static_argnames}
        leaves, tree = jax.tree.flatten(dict(bound.arguments))
        kinds = tuple(jax.api_util.shaped_abstractify(leaf) for leaf in leaves)
        precision = (config.jax_enable_x64, config.jax_default_matmul_precision)
        key = (tree, kinds, tuple(static.values()), precision)
        if key not in programs:
            compiler_options = options[count_numbers(leaves) >= optimized_from]
            programs[key] = _load_or_compile(
                store, function, caller, static, tree, leaves, key, compiler_options
            )
        program = programs[key]
        if program is None:
            return choose_jit(args, kwargs)(*args, **kwargs)
        return jax.tree.unflatten(program.result, program.program(leaves))

    return call


def _calling_module() -> str:
    """Name of the trinoc module that calls `kept_jit` during its import; "" if there is none.

    The stored program depends on the source of this module, for example on the axes of a `vmap`.
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
    """Load a program from the storage, or compile and store it; None if it cannot be stored.

    static : values of the static arguments.
    tree, leaves : structure of the other arguments, and their arrays.
    key : everything that distinguishes the program from others of the same function.
    """
    from jax.experimental import serialize_executable

    try:
        name, modules = _name(function, caller, key)
    except (pickle.PicklingError, TypeError, AttributeError):
        return None
    content = store.get(name, modules)
    if content is not None:
        try:
            prefetched = _prefetched.pop(content, None)
            executable = _load_executable(content) if prefetched is None else prefetched.result()
            stored: _StoredProgram = pickle.loads(content)
            if stored.uses_lapack:
                _make_lapack_ready()
            return _KeptProgram(executable, jax.tree.structure(pickle.loads(stored.result)))
        except Exception:
            pass
    results: list[Any] = []

    def flat(leaves: list[Any]) -> list[Any]:
        values, result = jax.tree.flatten(function(**jax.tree.unflatten(tree, leaves), **static))
        results[:] = [result]
        return values

    # A program from JAX's own cache cannot be serialized. A unique name makes it compile.
    flat.__name__ = f"{function.__name__}_{secrets.token_hex(4)}"
    with compiling():
        compiled = jax.jit(flat).lower(leaves).compile(compiler_options=options)
    result = results[0]
    try:
        # Custom calls of a loaded program must exist: only LAPACK's do.
        calls = set(re.findall(r'custom_call_target="([^"]*)"', compiled.as_text() or ""))
        if all(call.startswith(_LAPACK) for call in calls):
            like = jax.tree.unflatten(result, range(result.num_leaves))
            stored = _StoredProgram(
                executable=serialize_executable.serialize(compiled)[0],
                inputs=len(leaves),
                outputs=result.num_leaves,
                result=_pickle_known_classes(like)[0],
                uses_lapack=bool(calls),
            )
            store.put(name, pickle.dumps(stored, protocol=5), modules)
    except Exception:
        pass
    return _KeptProgram(compiled, result)


@contextlib.contextmanager
def prefetch_programs(contents: Iterable[bytes]) -> Iterator[None]:
    """Context in which a thread loads stored programs before they are called.

    Loading takes up to 0.4 s per program. The main thread can meanwhile import modules or detect
    patterns, because XLA releases Python's lock. A program that is never called, or that cannot be
    loaded, is ignored.

    Parameters
    ----------
    contents : iterable of bytes
        Contents of the program store, in the order in which the programs will be called.
    """
    # Imports of the thread could wait for those of the main thread.
    from jax.experimental import serialize_executable  # noqa: F401

    thread = ThreadPoolExecutor(1, thread_name_prefix="trinoc-prefetch")
    try:
        for content in contents:
            _prefetched[content] = thread.submit(_load_executable, content)
        yield
    finally:
        # After an early error nobody waits for the rest.
        thread.shutdown(wait=False, cancel_futures=True)
        _prefetched.clear()


def _load_executable(content: bytes) -> Callable[[list[Any]], list[Any]]:
    """Load the executable of a stored program, without an import of trinoc's modules.

    content : pickled `_StoredProgram`.
    """
    from jax.experimental import serialize_executable

    stored: _StoredProgram = pickle.loads(content)
    in_tree = jax.tree.structure((([0] * stored.inputs,), {}))
    out_tree = jax.tree.structure([0] * stored.outputs)
    return serialize_executable.deserialize_and_load(stored.executable, in_tree, out_tree)


@functools.cache
def _make_lapack_ready() -> None:
    """Register the addresses of LAPACK's functions, which JAX does only when it compiles a call."""
    try:
        # The first step of the lowering, without the rest, which takes a tenth of a second.
        from jaxlib.lapack import prepare_lapack_call

        prepare_lapack_call("potrf_ffi", np.dtype(float))
    except (ImportError, TypeError):  # JAX does not promise to keep this name
        jax.jit(jnp.linalg.cholesky).lower(np.eye(2))


def _name(
    function: Callable[..., Any], caller: str, key: tuple[Hashable, ...]
) -> tuple[str, frozenset[str]]:
    """Storage name of a program, and the modules on which the program depends.

    The name differs if the function or its arguments differ. The module of an argument's class is
    included, because the function may refer to the base class only.
    """
    tree, kinds, *rest = key
    kinds = [(k.shape, str(k.dtype), k.weak_type) for k in kinds]  # pyright: ignore
    identity = (function.__module__, function.__qualname__, tree, kinds, rest)
    content, modules = _pickle_known_classes(identity)
    function_modules = {function.__module__, caller} - {""}
    return hashlib.sha256(content).hexdigest(), frozenset(modules | function_modules)


class _KnownClassPickler(pickle.Pickler):
    """Pickler that refuses values of unknown classes, such as a user's own lens.

    Known are the classes of trinoc and of its libraries. An unknown class may change without a
    change of its name. The pickler collects the trinoc modules of all classes and functions in the
    value.
    """

    def __init__(self, parts: "_ByteChunks") -> None:
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


class _ByteChunks(list[bytes]):
    """Output of a pickler in memory: a list of chunks of bytes."""

    def write(self, part: bytes) -> None:
        self.append(bytes(part))


def _pickle_known_classes(value: Any) -> tuple[bytes, set[str]]:
    """Pickled value, and the trinoc modules of the classes and functions in it."""
    parts = _ByteChunks()
    pickler = _KnownClassPickler(parts)
    pickler.dump(value)
    return b"".join(parts), pickler.modules
