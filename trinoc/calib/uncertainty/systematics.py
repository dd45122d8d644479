"""Systematic errors of sheet, lens and aim, which repeated images do not show.

They affect all cameras over the sheet in the same way, so that they correlate the cameras'
parameters. They are larger than the noise: 0.1 % of print scale is half a millimetre of distance, a
hundred times the noise limit of a good image.
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

# numerical: smallest number of cameras for which a program is compiled.
CAMERAS_AT_ONCE = 3
_Item = TypeVar("_Item")


class Systematics(NamedTuple):
    """Standard deviations of systematic errors of sheet, lens and aim. 0 or None means exact.

    Each error is an unknown of the calibration, with a Gaussian prior. It is estimated as far as
    the images determine it, and its uncertainty is part of the covariance. `Systematics()` assumes
    that everything is exact.

    Attributes
    ----------
    print_scale_sigma : relative sigma of the print's scale along X and along Y (1e-3 is 0.1 %).
        `trinoc.calib.printed_sheet` determines both scales from two measured bars.
    flatness_mm : sigma of the height of the sheet at the circles farthest from the origin, for each
        of three bends: along X, along Y, and twisted.
    lens_covariance : (k, k) covariance of the first k of the lens's `parameter_names`, as `trinoc
        intrinsics` writes it. An ideal lens has the parameters of Brown-Conrady. One matrix: all
        cameras have the same calibrated lens and the same error. A mapping by camera: independent
        errors.
    print_size_sigma : relative sigma of the size of the whole print, common to X and Y.
    aim_sigma_mm : sigma along X and Y of the intersection of the optical axis and the sheet; the
        prior mean is the origin. Used with the pose model "aimed".
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
        """Typical errors of a print, of paper, of aiming by hand, and of a lens from a data sheet.

        The sigmas are: size of the print 0.2 %, ratio of its scales along X and Y 0.28 %, flatness
        0.3 mm. The optical axis meets the origin with a sigma of 20 mm. A lens given in millimetres
        and without distortion is assumed to come from a data sheet (`data_sheet_covariance`). A
        lens given in pixels is assumed to be calibrated. It is exact unless its covariance is
        given.

        Parameters
        ----------
        lenses : intrinsics of each camera.
        tuning : tuned constants of calibration; only benchmarks and studies change them.
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
        """Factors L (k, r) of the lens covariance L L^T, for each camera whose lens is uncertain.

        Parameters
        ----------
        lenses : intrinsics of all cameras; None for a camera that is not used.

        Raises
        ------
        InputError : a covariance has the wrong shape, is not finite, or belongs to a camera that is
            not in `lenses`.
        """
        covariance = self.lens_covariance
        if covariance is None:
            return {}
        if not isinstance(covariance, Mapping):
            return {
                name: _factor(_check_covariance(covariance, lens.lens, "of all cameras"))
                for name, lens in lenses.items()
                if lens is not None
            }
        for name in covariance:
            if name not in lenses:
                raise InputError(
                    f'`lens_covariance` names the camera "{name}", but the cameras are '
                    f"{list_names(lenses)}."
                )
        return {
            name: _factor(_check_covariance(matrix, lens.lens, f'of camera "{name}"'))
            for name, matrix in covariance.items()
            if (lens := lenses[name]) is not None
        }

    def check(self) -> None:
        """Raise `InputError` if a sigma is negative or not finite."""
        sigmas = np.array([*self._of_sheet, self.aim_sigma_mm])
        if not (np.isfinite(sigmas) & (sigmas >= 0)).all():
            raise InputError(
                "A sigma of `Systematics` is negative or not finite: give standard deviations."
            )

    def groups(self, cameras: Sequence[_Item]) -> list[Sequence[_Item]]:
        """Divide the cameras into groups that are adjusted together.

        All cameras form one group if they have an uncertain lens or sheet in common. Otherwise a
        group has at most `CAMERAS_AT_ONCE` cameras.

        Parameters
        ----------
        cameras : the cameras.
        """
        if any(self._of_sheet) or self.lens_is_shared:
            return [cameras]
        return [cameras[k : k + CAMERAS_AT_ONCE] for k in range(0, len(cameras), CAMERAS_AT_ONCE)]

    @property
    def _of_sheet(self) -> tuple[float, ...]:
        return (*self.print_scale_sigma, self.flatness_mm, self.print_size_sigma)

    @property
    def lens_is_shared(self) -> bool:
        """True if all cameras have the same lens with the same error."""
        covariance = self.lens_covariance
        return covariance is not None and not isinstance(covariance, Mapping)

    @property
    def descriptions(self) -> tuple[str, ...]:
        """Short description of each error that is not exact, with its sigma."""
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
            covariance = self.lens_covariance
            cameras = f" of {list_names(covariance)}" if isinstance(covariance, Mapping) else ""
            terms.append(f"the lens covariance{cameras}")
        return tuple(terms)


def data_sheet_covariance(
    lens: Intrinsics, *, tuning: CalibTuning = TUNING
) -> Float[np.ndarray, "5 5"]:
    """Covariance of fx, fy, cx, cy and k1 of a lens that is known from a data sheet only.

    The sigmas are: focal length 1 %, ratio of fx and fy 0.2 %, principal point 2 % of the image
    width. The sigma of the distortion moves the corners of the image by one pixel.

    Parameters
    ----------
    lens : intrinsics from the data sheet.
    tuning : tuned constants of calibration; only benchmarks and studies change them.

    Returns
    -------
    (5, 5) covariance, px^2 for the first four parameters.
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
            f"The lens covariance {whose} has values that are not finite or a negative variance: "
            "calibrate the lens again with the additional images that `trinoc intrinsics` "
            "recommends."
        )
    return matrix


def _factor(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k r"]:
    """Factor L (k, r) of a covariance L L^T, with one column per uncertain direction."""
    sigma = np.sqrt(np.diag(covariance))
    free = np.flatnonzero(sigma > 0)
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    values, vectors = np.linalg.eigh(correlation)
    positive = values > 1e-12 * values.max(initial=0.0)
    factor = np.zeros((len(covariance), int(positive.sum())))
    factor[free] = sigma[free, None] * vectors[:, positive] * np.sqrt(values[positive])
    return factor
