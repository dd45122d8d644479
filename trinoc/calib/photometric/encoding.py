"""How the grey levels of a rig's pictures stand for light, as far as somebody says it."""

from typing import Literal, NamedTuple

from trinoc.errors import InputError

Response = Literal["linear", "srgb", "fit"]
# The one parameter of the family of responses (`numerics.level_of_light`).
_BEND: dict[str, float | None] = {"linear": 0.0, "srgb": 1.0, "fit": None}


class Encoding(NamedTuple):
    """What is known of the pictures beside their size.

    Fields
    ------
    bayer : for raw mosaics, colours of the first two pixels of the first two rows, such as "RGGB";
        None for pictures that are none.
    response : "linear" or "srgb" where the camera's response is known, else "fit": linear, until
        the edges' profiles refute it.
    """

    bayer: str | None = None
    response: Response = "fit"

    @property
    def bend(self) -> float | None:
        """Of the response (0 linear, 1 sRGB); None where it is to be fitted."""
        return _BEND[self.response]

    def check(self) -> None:
        """Raise InputError for words that say nothing."""
        if self.bayer is not None and sorted(self.bayer) != sorted("RGGB"):
            raise InputError(
                f'bayer is "{self.bayer}", but must be "RGGB", "BGGR", "GRBG" or "GBRG".'
            )
        if self.response not in _BEND:
            raise InputError(f'response is "{self.response}", but must be linear, srgb or fit.')


# Nothing is known.
AS_DELIVERED = Encoding()
