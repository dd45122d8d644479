"""Processes forked after JAX had computed: they lack its threads, and its calls would hang."""

from trinoc.errors import TrinocError


class _JaxState:
    """Whether JAX has computed in this process, and in the one that this was forked from."""

    has_computed = False
    is_lost = False


def note_computation() -> None:
    """JAX has computed for trinoc in this process."""
    _JaxState.has_computed = True


def expect_no_fork() -> None:
    """Raise TrinocError in a process that was forked after JAX had computed."""
    if _JaxState.is_lost:
        raise TrinocError(
            "This process was forked from one in which trinoc had used JAX, whose threads a fork "
            "does not copy, so that this call would never end: start processes by "
            'multiprocessing.get_context("spawn") or "forkserver", or fork before the first call.'
        )


def note_fork() -> None:
    """This process has just been forked: the package's front door has this called."""
    _JaxState.is_lost = _JaxState.has_computed
