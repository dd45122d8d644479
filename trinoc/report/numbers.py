"""Numbers as people write them beside their uncertainty."""

import math
from collections.abc import Sequence


def significant_decimals(sigma: float, *, fallback: int = 4) -> int:
    """Number of decimals that shows two significant digits of `sigma`; `fallback` if `sigma` is
    NaN.
    """
    if not math.isfinite(sigma) or sigma <= 0:
        return fallback
    return max(0, min(12, 1 - math.floor(math.log10(sigma))))


def with_decimals(value: float, decimals: int) -> str:
    """Number as text with a typographic minus sign; "not known" for NaN."""
    if not math.isfinite(value):
        return "not known"
    text = f"{value:.{decimals}f}"
    # A rounded zero has no sign.
    return text.replace("-", "" if float(text) == 0 else "\N{MINUS SIGN}")


def with_sigma(value: float, sigma: float) -> str:
    """Value and sigma as text, such as "23.5681 ± 0.0010", with two significant digits of the
    sigma.
    """
    decimals = significant_decimals(sigma)
    text = with_decimals(value, decimals)
    return f"{text} ± {sigma:.{decimals}f}" if math.isfinite(sigma) else text


def point_text(point: Sequence[float], sigmas: Sequence[float]) -> str:
    """Coordinates of a point as text with their sigmas, such as "X 1.23 ± 0.04, Y ..., Z ..."."""
    return ", ".join(
        f"{axis} {with_sigma(float(value), float(sigma))}"
        for axis, value, sigma in zip("XYZ", point, sigmas, strict=True)
    )


def with_sign(value: float, decimals: int) -> str:
    """Number as text that always has a sign."""
    text = with_decimals(value, decimals)
    return f"+{text}" if math.isfinite(value) and value >= 0 else text


def percent(share: float) -> str:
    """Share (0 to 1) as text in per cent; "not known" for NaN."""
    return f"{100 * share:.0f} %" if math.isfinite(share) else "not known"


def round_scale(value: float) -> float:
    """Largest number of the form 1, 2 or 5 times a power of ten that is at most `value`."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


def plain(value: float) -> str:
    """Number as text without trailing zeros, such as 0.005, 20 or 2000."""
    return f"{value:.10f}".rstrip("0").rstrip(".")


def millimetres(value: float) -> str:
    """Length in mm as text with two digits, in micrometres below 0.01 mm: "0.35 mm", "1.2 µm"."""
    if not math.isfinite(value):
        return "not known"
    number, unit = (1000 * value, "µm") if value < 0.01 else (value, "mm")
    decimals = significant_decimals(number, fallback=0)
    return f"{number:.{min(decimals, 3)}f} {unit}"


def in_words(name: str) -> str:
    """Name from the code as text, with blanks for underscores."""
    return name.replace("_", " ")
