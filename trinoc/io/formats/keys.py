"""Keys of other tools' files: which keys are read, ignored or refused.

A reader that ignores an unknown key gives wrong results without a message if the key changes the
projection. So each reader declares its keys, and gets no others.
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
    """A key of another tool's file that `Keys.take` refuses.

    The value of the key changes the projection in a way that trinoc does not model.

    Attributes
    ----------
    what : str
        End of the error message after the key and its value: the reason and the remedy.
    harmless : sequence
        Values of the key that do not change the projection, and are accepted.
    """

    what: str
    harmless: Sequence[Any] = ()


class Keys(NamedTuple):
    """Lists of the keys of one kind of dictionary in another tool's file.

    Attributes
    ----------
    read : tuple of str
        Keys that the reader uses.
    left_out : tuple of str
        Keys that are ignored although their names look as if they changed the projection. Keys with
        other unknown names are always ignored.
    refused : mapping of str to Refused
        Keys that change the projection and that trinoc does not support.
    """

    read: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    refused: Mapping[str, Refused] = {}

    def take(self, block: Block) -> Block:
        """Return a copy of `block` with only the keys in `read`.

        Raise `InputError` for a key in `refused`, unless its value is harmless. Raise it also for a
        key in no list whose name looks as if it changed the projection.
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
