"""Which tracks are boundaries of cast shadows, and the lamp."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.match.tracks import EVEN, Matches


class Shadows(eqx.Module):
    """Probabilities of tracks, and the lamp that they rest on.

    Fields
    ------
    shadow : (t,) probability that each track of the matches is the boundary of a cast shadow.
    lamp_posterior : probability that the lamp below is the true one; 0 where there is none to tell.
    middle_mm : (3,) middle of the scene, from which the lamp is seen.
    toward_lamp : (3,) unit vector from there, in the world frame; zeros where nothing is known.
    nearness_per_mm : 1 over the distance of the lamp; 0 where its light is parallel.
    lamp_covariance : (3, 3) of the turn of `toward_lamp` about its two axes across
        (`trinoc.numerics.axes_across`), rad, and of `nearness_per_mm`.
    counts : what each step produced, by name.
    """

    shadow: Float[np.ndarray, "t"]
    lamp_posterior: float
    middle_mm: Float[np.ndarray, "3"]
    toward_lamp: Float[np.ndarray, "3"]
    nearness_per_mm: float
    lamp_covariance: Float[np.ndarray, "3 3"]
    counts: dict[str, int]

    @property
    def lamp_known(self) -> bool:
        """Whether the lamp found is likelier the true one than not."""
        return self.lamp_posterior > EVEN

    @property
    def lamp_sigma_deg(self) -> float:
        """Standard deviation of the lamp's direction, the larger one."""
        return float(np.degrees(np.sqrt(np.linalg.eigvalsh(self.lamp_covariance[:2, :2])[-1])))

    @property
    def lamp_mm(self) -> Float[np.ndarray, "4"]:
        """The lamp's place in homogeneous coordinates: infinitely far where the last is 0."""
        place = self.toward_lamp + self.nearness_per_mm * self.middle_mm
        return np.append(place, self.nearness_per_mm)

    def marked(self, matches: Matches) -> Matches:
        """The matches that the shadows were found in, with the mark "shadow"."""
        return matches.with_marks(shadow=self.shadow)

    def summary(self) -> str:
        """How many tracks are likely shadows, and where the lamp is."""
        marked = int((self.shadow > EVEN).sum())
        said = (
            "1 track is likely a shadow" if marked == 1 else f"{marked} tracks are likely shadows"
        )
        if not self.lamp_known:
            return f"{said}; no lamp stands out, so little is known of shadows."
        x, y, z = self.toward_lamp
        return (
            f"{said}; the lamp is toward ({x:.3f}, {y:.3f}, {z:.3f}) +- "
            f"{self.lamp_sigma_deg:.2f} degrees, posterior {self.lamp_posterior:.3f}."
        )

    def record(self) -> dict[str, Any]:
        """The same and the lamp's covariance, as JSON holds them."""
        return {
            "tracks_marked": int((self.shadow > EVEN).sum()),
            "lamp_posterior": self.lamp_posterior,
            "middle_mm": self.middle_mm.tolist(),
            "toward_lamp": self.toward_lamp.tolist(),
            "nearness_per_mm": self.nearness_per_mm,
            "lamp_covariance": self.lamp_covariance.tolist(),
            "counts": self.counts,
        }
