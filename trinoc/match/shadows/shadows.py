"""Which tracks are boundaries of cast shadows, and the lamp."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.match.tracks import Matches


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
        return self.lamp_posterior > 0.5

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
