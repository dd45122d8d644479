"""Guard against processes forked after JAX was used: without its threads, JAX calls would hang."""

from trinoc.errors import TrinocError


class _JaxState:
    """State of JAX in this process.

    Attributes
    ----------
    has_computed : bool
        True if JAX has computed in this process.
    is_lost : bool
        True if the process was forked after JAX had computed in the parent process. JAX calls would
        then hang.
    """

    has_computed = False
    is_lost = False


def note_computation() -> None:
    """Record that JAX has computed in this process."""
    _JaxState.has_computed = True


def expect_no_fork() -> None:
    """Raise `TrinocError` if this process was forked after JAX had computed in its parent."""
    if _JaxState.is_lost:
        raise TrinocError(
            "This process was forked after trinoc had used JAX; a fork does not copy its threads, "
            "so this call would never end. Start processes by "
            'multiprocessing.get_context("spawn") or "forkserver", or fork before the first call.'
        )


def note_fork() -> None:
    """Record that this process was forked.

    `trinoc/__init__.py` registers this function with `os.register_at_fork`.
    """
    _JaxState.is_lost = _JaxState.has_computed
