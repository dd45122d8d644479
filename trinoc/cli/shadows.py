"""What commands say of shadows."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trinoc.match import Shadows

EVEN = 0.5


def shadows_text(shadows: "Shadows") -> str:
    """Two sentences for people: how many tracks, and where the lamp is."""
    marked = int((shadows.shadow > EVEN).sum())
    number = "1 track is likely a shadow" if marked == 1 else f"{marked} tracks are likely shadows"
    if not shadows.lamp_known:
        return f"{number}; no lamp stands out, so little is known of shadows."
    x, y, z = shadows.toward_lamp
    return (
        f"{number}; the lamp is toward ({x:.3f}, {y:.3f}, {z:.3f}) +- "
        f"{shadows.lamp_sigma_deg:.2f} degrees, posterior {shadows.lamp_posterior:.3f}."
    )


def shadows_record(shadows: "Shadows") -> dict[str, Any]:
    """What programs want to know of them, as JSON can hold it."""
    return {
        "tracks_marked": int((shadows.shadow > EVEN).sum()),
        "lamp_posterior": shadows.lamp_posterior,
        "middle_mm": shadows.middle_mm.tolist(),
        "toward_lamp": shadows.toward_lamp.tolist(),
        "nearness_per_mm": shadows.nearness_per_mm,
        "lamp_covariance": shadows.lamp_covariance.tolist(),
        "counts": shadows.counts,
    }
