"""How many coefficients of distortion the pictures determine, and how many they ask for.

All that are determined stay free. Leaving out a coefficient because it is within its noise would
lend the others sigmas that hold only if it is exactly zero: measured, their errors were then
more than twice the claimed sigmas, while freeing it costs the focal length nothing.
"""

from typing import NamedTuple

import numpy as np

from trinoc.calib.intrinsics.lens_fit import LensFit
from trinoc.calib.intrinsics.lens_information import lens_observability
from trinoc.calib.intrinsics.lens_parameters import LensModel
from trinoc.calib.intrinsics.robust_lens import LensImages, fit_model
from trinoc.calib.intrinsics.zhang import ZhangStart
from trinoc.numerics import Observability

# What a coefficient must lower chi-square by to be asked for: Akaike's price.
_PRICE = 2.0
# Chi-square beyond this many of its own standard deviations is not noise: the sigmas grow.
_CHI_SQUARE_DEVIATIONS = 4.0


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
    """The lens with as many coefficients of `model` as are determined.

    Those that the lens's model calls dispensable are given up one after the other; the fit of
    `model` itself where what remains is not determined either.
    """
    richest = fit_candidate(start, model, images)
    candidate = richest
    for name in model.lens.dispensable:
        if not candidate.determined and name in candidate.model.distortion:
            candidate = fit_candidate(start, candidate.model.without(name), images)
    return candidate if candidate.determined else richest


def fit_candidate(start: ZhangStart, model: LensModel, images: LensImages) -> Candidate:
    """One model fitted; coefficients that it does not free are zero."""
    names = start.lens.parameter_names
    held = [name in model.lens.coefficient_names and name not in model.free for name in names]
    lens = start.lens.with_parameters(np.where(held, 0.0, start.lens.parameters))
    fit = fit_model(ZhangStart(lens, start.cam_from_world), model, images)
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
    rows = [candidate.model.lens.parameter_names.index(name) for name in names]
    values = np.asarray(candidate.fit.lens.parameters)[rows]
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
    kept = model.lens.coefficient_names[:count]
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
    for count in candidate.model.lens.coefficient_counts:
        kept = candidate.model.lens.coefficient_names[:count]
        if set(kept) <= set(free):
            gain = chi_square_gain(candidate, tuple(name for name in free if name not in kept))
            offers.append((gain + _PRICE * len(kept), count, gain))
    _, count, gain = min(offers)
    return count, gain
