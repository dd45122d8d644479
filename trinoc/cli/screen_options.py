"""The screen of `trinoc pattern -o sheet.png`, and how large its pixels are."""

import math
from typing import NamedTuple

from trinoc.cli.command import UsageError

_MM_PER_INCH = 25.4
# Glasses for virtual reality have pixels of .01 mm, walls of diodes of 4 mm.
_PITCHES_MM = (0.005, 5.0)
_MOST_PX = 20_000


class ScreenOptions(NamedTuple):
    """What the user says of the screen; a size of (0, 0) and None where nothing is said."""

    size_px: tuple[int, int]
    inch: float | None
    pitch_mm: float | None

    def checked_pitch_mm(self, *, is_meant: bool) -> float | None:
        """From one pixel to the next; None where no screen is meant. Raises UsageError."""
        said = self.size_px != (0, 0) or self.inch is not None or self.pitch_mm is not None
        if not is_meant:
            if said:
                raise UsageError("--screen-... is of a screen as target: give -o FILE.png, too.")
            return None
        if not all(0 < side <= _MOST_PX for side in self.size_px):
            raise UsageError(
                "A PNG is made for one screen: give its width and height, such as "
                "--screen-px 1920 1080."
            )
        if (self.inch is None) == (self.pitch_mm is None):
            raise UsageError(
                "How large the pixels of the screen are, one of two says: give --screen-inch, its "
                "diagonal, such as 24, or --screen-pitch-mm, such as 0.27."
            )
        pitch_mm = self.pitch_mm
        if self.inch is not None:
            pitch_mm = self.inch * _MM_PER_INCH / math.hypot(*self.size_px)
        least, most = _PITCHES_MM
        if pitch_mm is None or not least <= pitch_mm <= most:
            raise UsageError(
                f"Pixels of {pitch_mm:g} mm are on no screen: the diagonal is in inches, the pitch "
                "in millimetres."
            )
        return pitch_mm
