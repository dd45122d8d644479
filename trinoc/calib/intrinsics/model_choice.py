"""How many coefficients of distortion the pictures determine, and how many they ask for.

All that are determined stay free. Leaving out a coefficient because it is within its noise would
lend the others sigmas that hold only if it is exactly zero: measured, their errors were then
more than twice the claimed sigmas, while freeing it costs the focal length nothing.
"""

from typing import NamedTuple

import numpy as np

from trinoc.calib.intrinsics.lens_fit import LensFit
from trinoc.calib.intrinsics.lens_information import lens_observability
from trinoc.calib.intrinsics.lens_parameters import LENS_PARAMETERS, LensModel
from trinoc.calib.intrinsics.robust_lens import LensImages, fit_model
from trinoc.calib.intrinsics.zhang import ZhangStart
from trinoc.numerics import Observability

# What a coefficient must lower chi-square by to be asked for: Akaike's price.
_PRICE = 2.0
# Chi-square beyond this many of its own standard deviations is not noise: the sigmas grow.
_CHI_SQUARE_DEVIATIONS = 4.0
# Models in the order of the number of coefficients by which users name them.
_COUNTS = {0: (0, False), 1: (1, False), 2: (2, False), 4: (2, True), 5: (3, True)}


class Candidate(NamedTuple):
    """A model that was fitted, and how well it did.

    Fields
    ------
    model : what was free.
    fit : where it ended.
    chi_square : of the circles that take part.
    freedom : residuals less unknowns.
    seen : what the pictures determine of the lens; variances are enlarged where the residuals
        are larger than the circles' own covariances explain.
    """

    model: LensModel
    fit: LensFit
    chi_square: float
    freedom: int
    seen: Observability

    @property
    def reduced_chi_square(self) -> float:
        """Chi-square per degree of freedom; NaN without any."""
        return self.chi_square / self.freedom if self.freedom > 0 else float("nan")

    @property
    def determined(self) -> bool:
        """Whether the fit ended and the pictures determine all that was free."""
        return bool(self.fit.converged) and self.seen.rank == len(self.model.free)


def fit_determined(start: ZhangStart, model: LensModel, images: LensImages) -> Candidate:
    """The lens with as many radial coefficients of `model`, one at least, as are determined.

    The fit of `model` itself where none of those is determined.
    """
    richest = fit_candidate(start, model, images)
    candidate = richest
    while not candidate.determined and candidate.model.radial > 1:
        fewer = candidate.model._replace(radial=candidate.model.radial - 1)
        candidate = fit_candidate(start, fewer, images)
    return candidate if candidate.determined else richest


def fit_candidate(start: ZhangStart, model: LensModel, images: LensImages) -> Candidate:
    """One model fitted; coefficients that it does not free are zero."""
    held = [name not in model.free for name in LENS_PARAMETERS[4:]]
    values = np.append(start.values[:4], np.where(held, 0.0, start.values[4:]))
    fit = fit_model(ZhangStart(values, start.cam_from_world), model, images)
    residual_count = 2 * sum(int(used.sum()) for used in images.used)
    chi_square = float(np.sum(fit.whitened**2))
    freedom = residual_count - len(model.free) - 6 * len(images.detections)
    seen = lens_observability(fit, model, variance_factor(chi_square, freedom))
    return Candidate(model, fit, chi_square, freedom, seen)


def variance_factor(chi_square: float, freedom: int) -> float:
    """What the claimed variances are to be multiplied by: 1 unless the residuals refute them."""
    if freedom <= 0:
        return 1.0
    reduced = chi_square / freedom
    refuted = reduced > 1.0 + _CHI_SQUARE_DEVIATIONS * np.sqrt(2.0 / freedom)
    return reduced if refuted else 1.0


def chi_square_gain(candidate: Candidate, names: tuple[str, ...]) -> float:
    """By how much freeing these coefficients lowers chi-square in units of the noise (Wald)."""
    if not names:
        return 0.0
    rows = [LENS_PARAMETERS.index(name) for name in names]
    values = np.asarray(candidate.fit.values)[rows]
    return float(values @ np.linalg.solve(candidate.seen.covariance[np.ix_(rows, rows)], values))


def choice_sentence(candidate: Candidate, asked: LensModel) -> str | None:
    """Which coefficients the pictures ask for; None where there is nothing to say."""
    model = candidate.model
    if not candidate.determined or not model.distortion:
        return None
    sentences = []
    missing = [name for name in asked.distortion if name not in model.distortion]
    if missing:
        sentences.append(f"The pictures cannot determine {', '.join(missing)}, held at 0.")
    count, gain = _fewest_coefficients(candidate)
    kept = LensModel(*_COUNTS[count]).distortion
    extra = tuple(name for name in model.distortion if name not in kept)
    if extra:
        sentences.append(
            f"The pictures ask for {', '.join(kept) or 'no distortion'}; {', '.join(extra)} "
            f"lower{'s' if len(extra) == 1 else ''} chi-square by {gain:.1f}, no more than noise "
            f"does: distortion={count} would leave {'it' if len(extra) == 1 else 'them'} out."
        )
    return " ".join(sentences) or None


def _fewest_coefficients(candidate: Candidate) -> tuple[int, float]:
    """The number of coefficients that pays best, and what the others lower chi-square by."""
    free = candidate.model.distortion
    offers = []
    for count, (radial, tangential) in _COUNTS.items():
        kept = LensModel(radial, tangential).distortion
        if set(kept) <= set(free):
            gain = chi_square_gain(candidate, tuple(name for name in free if name not in kept))
            offers.append((gain + _PRICE * len(kept), count, gain))
    _, count, gain = min(offers)
    return count, gain
