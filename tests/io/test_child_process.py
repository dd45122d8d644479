"""A reader in a child process gives its value; whatever it does to its process is one sentence."""

import math

import pytest

from trinoc.errors import InputError
from trinoc.io.child_process import read_in_child

READERS = "tests.io.child_readers"


def test_the_value_comes_back():
    value = read_in_child(f"{READERS}:count", b"\x00\r\n\xff", "file")
    assert value["bytes"] == 4
    assert value["numbers"][0] == 0.1
    assert math.isnan(value["numbers"][1])


@pytest.mark.parametrize(
    ("reader", "problem"),
    [
        ("crash", "its reader crashes"),
        ("leave", "its reader crashes"),
        ("fail", "ValueError: two lines"),
        ("fill", "more memory"),
        ("wait", "more than 2 s"),
    ],
)
def test_what_ends_or_stalls_the_child_is_a_sentence(reader, problem):
    seconds = 2.0 if reader == "wait" else 30.0
    with pytest.raises(InputError, match=problem) as caught:
        read_in_child(f"{READERS}:{reader}", b"content", "file.mat", seconds)
    assert str(caught.value).startswith("file.mat is damaged")
    assert "\n" not in str(caught.value)
