"""How the grey levels of a rig's pictures stand for light, as far as somebody says it."""

from typing import Literal, NamedTuple, get_args

from trinoc.errors import InputError
from trinoc.image import PowerResponse, response_of

Response = Literal["linear", "srgb", "fit"]


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
        if self.response == "fit":
            return None
        known = response_of(self.response)
        assert isinstance(known, PowerResponse)
        return float(known.bend)

    def check(self) -> None:
        """Raise InputError for words that say nothing."""
        if self.bayer is not None and sorted(self.bayer) != sorted("RGGB"):
            raise InputError(
                f'bayer is "{self.bayer}", but must be "RGGB", "BGGR", "GRBG" or "GBRG".'
            )
        if self.response not in get_args(Response):
            raise InputError(f'response is "{self.response}", but must be linear, srgb or fit.')


# Nothing is known.
AS_DELIVERED = Encoding()
