"""The keys of another tool's file: which are read, which may be left out, which are refused.

A reader that takes the keys it knows and no notice of others is wrong without a word as soon as a
file has a key that changes the projection. So a reader declares its keys, and gets no others.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from trinoc.io.json_document import Block, show_value

# In the name of a key: what may change where a point is imaged.
_CHANGES_PROJECTION = re.compile(
    r"(^|_)(xi|alpha|beta|gamma|[kpst]_?\d+)($|_)|skew|shear|affin|fisheye|omni|dist(?!ance)|coeff|lens|binning"
    r"|roi|crop|resiz|scale|unit|orientation|flip|mirror|shutter|rectif|(^|_)(camera_)?model($|_)",
    re.IGNORECASE,
)
# Of difflib: how alike a misspelt key is to the one that is meant.
_ALIKE = 0.75


class Refused(NamedTuple):
    """A key whose value changes the projection in a way that trinoc's cameras do not have.

    what : it says and what to do, as a sentence goes on after the key and its value.
    harmless : values with which it changes nothing.
    """

    what: str
    harmless: Sequence[Any] = ()


class Keys(NamedTuple):
    """The keys of a map in a file.

    read : those that the reader takes, which change the cameras.
    left_out : those that change no projection, although their names look so. Other keys are left
        out, too, where their names do not.
    refused : those that change it and are not read.
    """

    read: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    refused: Mapping[str, Refused] = {}

    def take(self, block: Block) -> Block:
        """The keys that are read, and no others.

        Raises InputError for a key that is refused, unless its value is harmless, and for one that
        is not declared and whose name looks as if it changed the projection.
        """
        for key, value in block.values.items():
            if key in self.read or key in self.left_out or value is None:
                continue
            if key in self.refused:
                refused = self.refused[key]
                if value not in refused.harmless:
                    raise block.error(key, f"is {show_value(value)}: {refused.what}.")
            elif _CHANGES_PROJECTION.search(key):
                close_keys = difflib.get_close_matches(key, self.read, n=1, cutoff=_ALIKE)
                raise block.error(
                    key,
                    f'is an unknown key: did you mean "{close_keys[0]}"?'
                    if close_keys and close_keys[0] not in block.values
                    else "may change the projection of points, and trinoc does not read this key: "
                    "remove the key if it has no effect, or convert the camera to a model "
                    "without it.",
                )
        read = {key: value for key, value in block.values.items() if key in self.read}
        return Block(read, block.file, block.place)
