"""What commands say of rims."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trinoc.match import Rims


def rims_text(rims: "Rims") -> str:
    """A sentence, and a line for each, for people."""
    lines = [
        f"rim {row}: radius {rims.radius_mm[row]:.3f} +- {rims.radius_sigma_mm[row]:.3f} mm, "
        f"{rims.covered[row]:.0%} of it seen"
        for row in range(len(rims))
    ]
    found = "1 rim" if len(lines) == 1 else f"{len(lines)} rims"
    return "\n".join([f"{found} of round bodies, in pieces after the other tracks.", *lines])


def rims_record(rims: "Rims") -> dict[str, Any]:
    """What programs want to know of them, as JSON can hold it."""
    return {
        "found": [
            {
                "centre_mm": rims.centre_mm[row].tolist(),
                "normal": rims.normal[row].tolist(),
                "radius_mm": float(rims.radius_mm[row]),
                "radius_sigma_mm": float(rims.radius_sigma_mm[row]),
                "covered": float(rims.covered[row]),
            }
            for row in range(len(rims))
        ],
        "counts": rims.counts,
    }
