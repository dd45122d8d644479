"""Every reader on valid files that were damaged: a value, or one sentence of the typed errors."""

import pytest
from hypothesis import Phase, given, settings, strategies as st

from tests.io.valid_files import valid_files
from trinoc.errors import TrinocError

HUGE = [b"99999999999999999999", b"-1", b"1e400", b"NaN", b"0", b"\xff\xff\xff\x7f", b"[" * 99]
ODD = [
    b"null",
    b"{}",
    b"!!python/object/apply:os.system",
    b"<script>",
    b"../../x",
    b"\x00",
    b"&a *a",
]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return valid_files(tmp_path_factory.mktemp("valid"))


def test_every_valid_file_is_read(files):
    for file in files.values():
        assert file.load() is not None


@st.composite
def damages(draw):
    """Functions that damage the bytes of a file."""
    kind = draw(st.sampled_from(["cut", "flip", "put", "replace", "repeat"]))
    fraction, length = draw(st.floats(0, 1)), draw(st.integers(1, 12))
    bits = draw(st.integers(1, 255))
    inserted = draw(st.sampled_from([*HUGE, *ODD]) | st.binary(max_size=6))

    def damaged(content):
        offset = int(fraction * len(content))
        match kind:
            case "cut":
                return content[:offset]
            case "flip":
                offset = min(offset, len(content) - 1)
                return content[:offset] + bytes([content[offset] ^ bits]) + content[offset + 1 :]
            case "put":
                return content[:offset] + inserted + content[offset:]
            case "replace":
                return content[:offset] + inserted + content[offset + length :]
            case _:
                return content[:offset] + content[offset : offset + length] * 40 + content[offset:]

    return damaged


# Shrinking would go over all files again and again: the kind of file and its bytes say enough.
@settings(max_examples=12, phases=[Phase.explicit, Phase.generate])
@given(damaged=st.lists(damages(), min_size=1, max_size=3))
def test_damaged_files_are_values_or_sentences(files, damaged):
    for kind, file in files.items():
        original = content = file.path.read_bytes()
        for change in damaged:
            content = change(content) if content else content
        file.path.write_bytes(content)
        message = "a value"
        try:
            file.load()
        except TrinocError as error:
            message = str(error)
        finally:
            file.path.write_bytes(original)
        assert message, kind
        assert "\n" not in message, kind
