"""Errors that no repetition of a picture shows: of the sheet and of the lens.

They move every camera that looks at the sheet in the same way, so that they join the cameras'
parameters in one covariance, and they are larger than the noise: a tenth of a percent of print
scale is half a millimetre of distance, a hundred times the bound of a good picture.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import InputError, list_names
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.registry import promote_lens

# numerical: cameras of one program; it exists for so many, and for few larger numbers.
CAMERAS_AT_ONCE = 3
_Item = TypeVar("_Item")


class Systematics(NamedTuple):
    """What is known of the errors of sheet, lens and aim; zeros and None leave them out.

    Each is an unknown with this prior: where the pictures show it, it is fitted along; where they
    do not, it is in the covariance. `Systematics()` takes everything as exact.

    Fields
    ------
    print_scale_sigma : of the print's scale along X and along Y, as shares (1e-3 is a tenth of
        a percent). `trinoc.calib.printed_sheet` gets them from two measured bars.
    flatness_mm : sigma of the height, at the circles farthest from the origin, of each of the
        three ways in which a sheet bends: along X, along Y, and twisted.
    lens_covariance : (k, k) of the first k of the lens's `parameter_names` (for an ideal lens those
        of Brown-Conrady), as `trinoc intrinsics` writes it. One matrix is of one calibrated lens
        that all cameras were given, whose error they share; a mapping holds one for each camera by
        name, and those errors are independent.
    print_size_sigma : of the whole print's size, along X and Y alike, as a share.
    aim_sigma_mm : of the point of the sheet that the optical axis meets, along X and along Y, about
        the origin; it counts where the pose model is "aimed".
    """

    print_scale_sigma: tuple[float, float] = (0.0, 0.0)
    flatness_mm: float = 0.0
    lens_covariance: np.ndarray | Mapping[str, np.ndarray] | None = None
    print_size_sigma: float = 0.0
    aim_sigma_mm: float = 0.0

    @classmethod
    def typical(
        cls, lenses: Mapping[str, Intrinsics], *, tuning: CalibTuning = TUNING
    ) -> "Systematics":
        """Typical errors of a print, of paper, of aiming by hand, and of a lens's data sheet.

        The print is larger or smaller by .2 %, and longer along one side than along the other by
        .28 %; paper lies flat to .3 mm; the optical axis meets the origin to 20 mm, which is no
        more than that the camera looks at the sheet. A lens that is given in millimetres and
        without distortion comes from a data sheet: see `data_sheet_covariance`. One given in
        pixels comes from a calibration, and counts as exact unless its covariance is given.

        `tuning` holds every tuned constant of calibration; a benchmark or a study changes them.
        """
        assumed = tuning.uncertainty
        return cls(
            print_scale_sigma=(assumed.print_stretch, assumed.print_stretch),
            flatness_mm=assumed.flatness_mm,
            lens_covariance={
                name: data_sheet_covariance(lens, tuning=tuning)
                for name, lens in lenses.items()
                if lens.pixel_pitch_mm is not None and not lens.has_distortion
            }
            or None,
            print_size_sigma=assumed.print_size,
            aim_sigma_mm=assumed.aim_mm,
        )

    def lens_factors(
        self, lenses: Mapping[str, Intrinsics | None]
    ) -> dict[str, Float[np.ndarray, "_ _"]]:
        """For each camera whose lens is uncertain, L (k, r) with L L^T its covariance.

        lenses : of all cameras; None for one that takes no part.

        Raises InputError for a covariance of another shape or not finite, or one of a camera
        that is not among `lenses`.
        """
        given = self.lens_covariance
        if given is None:
            return {}
        if not isinstance(given, Mapping):
            return {
                name: _factor(_check_covariance(given, lens.lens, "of all cameras"))
                for name, lens in lenses.items()
                if lens is not None
            }
        for name in given:
            if name not in lenses:
                raise InputError(
                    f'`lens_covariance` names the camera "{name}", but the cameras are '
                    f"{list_names(lenses)}."
                )
        return {
            name: _factor(_check_covariance(matrix, lens.lens, f'of camera "{name}"'))
            for name, matrix in given.items()
            if (lens := lenses[name]) is not None
        }

    def check(self) -> None:
        """Raises InputError for a sigma that is negative or not finite."""
        sigmas = np.array([*self._of_sheet, self.aim_sigma_mm])
        if not (np.isfinite(sigmas) & (sigmas >= 0)).all():
            raise InputError(
                "A sigma of `Systematics` is negative or not finite: give standard deviations."
            )

    def groups(self, cameras: Sequence[_Item]) -> list[Sequence[_Item]]:
        """Cameras to be adjusted together: all where they share a lens or a sheet that is not
        exact, else a few at a time."""
        if any(self._of_sheet) or self.lens_is_shared:
            return [cameras]
        return [cameras[k : k + CAMERAS_AT_ONCE] for k in range(0, len(cameras), CAMERAS_AT_ONCE)]

    @property
    def _of_sheet(self) -> tuple[float, ...]:
        return (*self.print_scale_sigma, self.flatness_mm, self.print_size_sigma)

    @property
    def lens_is_shared(self) -> bool:
        """Whether all cameras look through one lens, whose error they share."""
        given = self.lens_covariance
        return given is not None and not isinstance(given, Mapping)

    @property
    def words(self) -> tuple[str, ...]:
        """The terms that are in, for people."""
        terms = []
        if self.aim_sigma_mm:
            terms.append(f"the aim ({self.aim_sigma_mm:.3g} mm)")
        if self.print_size_sigma:
            terms.append(f"print size ({100 * self.print_size_sigma:.3g} %)")
        if any(self.print_scale_sigma):
            x, y = (100 * sigma for sigma in self.print_scale_sigma)
            terms.append(f"print scale ({x:.3g} % along X, {y:.3g} % along Y)")
        if self.flatness_mm:
            terms.append(f"flatness of the sheet ({self.flatness_mm:.3g} mm)")
        if self.lens_covariance is not None:
            given = self.lens_covariance
            of = f" of {list_names(given)}" if isinstance(given, Mapping) else ""
            terms.append(f"the lens's own covariance{of}")
        return tuple(terms)


def data_sheet_covariance(
    lens: Intrinsics, *, tuning: CalibTuning = TUNING
) -> Float[np.ndarray, "5 5"]:
    """Covariance of fx, fy, cx, cy and k1 of a lens that only its data sheet describes.

    The focal length is off by 1 %, and by .2 % more along v than along u; the principal point by
    2 % of the picture's width; distortion moves the corners of the picture by one pixel.

    `tuning` holds every tuned constant of calibration; a benchmark or a study changes them.
    """
    (fu, fv), (width, height) = np.asarray(lens.focal_length_px), lens.image_size_px
    assumed, factor = tuning.uncertainty, np.zeros((5, 5))
    factor[:2, 0] = assumed.focal_length * fu, assumed.focal_length * fv
    factor[:2, 1] = 0.5 * assumed.aspect * fu, -0.5 * assumed.aspect * fv
    factor[[2, 3], [2, 3]] = assumed.principal_point * width
    radius = 0.5 * np.hypot(width / fu, height / fv)
    factor[4, 4] = assumed.distortion_px / (float(np.sqrt(fu * fv)) * radius**3)
    return factor @ factor.T


def _check_covariance(
    matrix: np.ndarray, lens: AbstractLens, whose: str
) -> Float[np.ndarray, "k k"]:
    matrix, names = np.asarray(matrix, dtype=np.float64), promote_lens(lens).parameter_names
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or len(matrix) > len(names):
        raise InputError(
            f"The lens covariance {whose} has shape {matrix.shape}, but must be (k, k) for the "
            f"first k of {', '.join(names)}."
        )
    if not (np.isfinite(matrix).all() and (np.diag(matrix) >= 0).all()):
        raise InputError(
            f"The lens covariance {whose} is no covariance of a lens that is determined: "
            "take the pictures that `trinoc intrinsics` asks for."
        )
    return matrix


def _factor(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k r"]:
    """One sigma along each direction in which the lens is uncertain."""
    sigma = np.sqrt(np.diag(covariance))
    free = np.flatnonzero(sigma > 0)
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    values, vectors = np.linalg.eigh(correlation)
    kept = values > 1e-12 * values.max(initial=0.0)
    factor = np.zeros((len(covariance), int(kept.sum())))
    factor[free] = sigma[free, None] * vectors[:, kept] * np.sqrt(values[kept])
    return factor
