"""What commands say of cylinders."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trinoc.match import Cylinders

EVEN = 0.5


def cylinders_text(cylinders: "Cylinders") -> str:
    """A sentence, and a line for each, for people."""
    marked = int((cylinders.silhouette > EVEN).sum())
    lines = [
        f"cylinder {row}: radius {cylinders.radius_mm[row]:.3f} +- "
        f"{cylinders.radius_sigma_mm[row]:.3f} mm, posterior {cylinders.posterior[row]:.3f}"
        for row in range(len(cylinders))
    ]
    found = "1 cylinder" if len(lines) == 1 else f"{len(lines)} cylinders"
    return "\n".join([f"{found}; {marked} tracks hold an outline of one.", *lines])


def cylinders_record(cylinders: "Cylinders") -> dict[str, Any]:
    """What programs want to know of them, as JSON can hold it."""
    return {
        "found": [
            {
                "axis_mm": cylinders.axis_mm[row].tolist(),
                "radius_mm": float(cylinders.radius_mm[row]),
                "radius_sigma_mm": float(cylinders.radius_sigma_mm[row]),
                "posterior": float(cylinders.posterior[row]),
                "rival_posterior": float(cylinders.rival_posterior[row]),
                "outlines": {
                    name: found.tolist() for name, found in cylinders.outlines_of(row).items()
                },
            }
            for row in range(len(cylinders))
        ],
        "tracks_marked": int((cylinders.silhouette > EVEN).sum()),
        "counts": cylinders.counts,
    }
