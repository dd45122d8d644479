"""Wrong shapes are refused in the first calls of a file, and checks end after as many."""

import jaxtyping
import numpy as np
import pytest

from tests import first_calls
from tests.first_calls import MOST_CALLS, begin_file
from trinoc.numerics import programs
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.vectors import complete_axes


def test_the_first_calls_of_each_file_are_checked() -> None:
    right, wrong = np.eye(3), np.ones((2, 4))
    for _ in range(2):
        begin_file()
        for call in range(MOST_CALLS):
            if call % 8 == 0:
                with pytest.raises(jaxtyping.TypeCheckError):
                    complete_axes(wrong)
            else:
                complete_axes(right)
        # Counted with results: neither is asked any more.
        for _ in range(MOST_CALLS):
            complete_axes(right)
        assert getattr(complete_axes.__wrapped__, "__no_type_check__", False)
    begin_file()
    with pytest.raises(jaxtyping.TypeCheckError):
        complete_axes(wrong)


def test_a_function_within_a_function_is_not_wrapped() -> None:
    """Its annotations would be checked again at each call of the outer function."""
    assert kept_jit.__code__.co_filename == first_calls.__file__
    assert programs.__name__.split(".")[-1] in kept_jit(complete_axes).__code__.co_filename
