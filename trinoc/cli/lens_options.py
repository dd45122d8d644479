"""Options of commands for lenses and for the sigmas of sheet, aim and lens."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import trinoc
from trinoc.cli.command import LOGGER, UsageError
from trinoc.cli.settings import parse_number, parse_pair
from trinoc.cli.views import files_of_views, warn_of_folds
from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np


# Not None: an option that may be numbers or nothing would take pictures that follow it.
NO_NUMBERS = (0.0, 0.0, 0.0)
# From an endoscope's lens to a telescope.
FOCAL_RANGE_MM = (0.1, 10_000.0)


def _sigma(text: str) -> float:
    number = parse_number(text)
    if number < 0:
        raise ValueError("is no standard deviation: give 0 or more")
    return number


def _zero(text: str) -> float:
    if _sigma(text) > 0:
        raise ValueError(
            "is not supported here: the covariance of a lens is in its camera.json, and lens=0 "
            "assumes an exact lens"
        )
    return 0.0


# Of a board, and of one sheet that cameras with a lens look at.
BOARD_SIGMA: Mapping[str, Callable[[str], Any]] = {
    "print_scale": parse_pair(_sigma),
    "flatness_mm": _sigma,
}
SIGMA: Mapping[str, Callable[[str], Any]] = {**BOARD_SIGMA, "aim_mm": _sigma, "lens": _zero}


def print_systematics(sigma: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of `Systematics` about the print, from the settings of --sigma."""
    fields = {name: sigma[name] for name in ("flatness_mm",) if name in sigma}
    if "print_scale" in sigma:
        fields |= {"print_scale_sigma": sigma["print_scale"], "print_size_sigma": 0.0}
    return fields


def expect_pixel_pitch(pitch_mm: tuple[float, float] | None, where: str) -> None:
    """Raise UsageError if no sensor has pixels of this size.

    where : beginning of the message.
    """
    from trinoc.io.intrinsics_json import expect_pitch

    try:
        expect_pitch(pitch_mm, where)
    except InputError as error:
        raise UsageError(str(error)) from error


def expect_focal_length(focal_length_mm: float) -> None:
    """Raise UsageError if the focal length is apparently not in mm."""
    shortest, longest = FOCAL_RANGE_MM
    if focal_length_mm <= 0:
        raise UsageError(
            f"--lens-mm has a focal length of {focal_length_mm:g} mm, but must have a positive one."
        )
    for unit, factor in (("metres", 1e3), ("micrometres", 1e-3)):
        length_mm = focal_length_mm * factor
        wrong = focal_length_mm < shortest if factor > 1 else focal_length_mm > longest
        if wrong and shortest <= length_mm <= longest:
            raise UsageError(
                f"--lens-mm has a focal length of {focal_length_mm:g} mm, which looks like {unit}: "
                f"write {length_mm:g} millimetres."
            )


def _warn_of_sizes(sizes_px: Mapping[str, tuple[int, int]]) -> None:
    """Log a warning if the images of cameras with one common lens differ in size."""
    if len(set(sizes_px.values())) > 1:
        sizes = ", ".join(
            f"{name} {width} x {height}" for name, (width, height) in sizes_px.items()
        )
        LOGGER.warning(
            "--lens-mm is one lens for all cameras, but their pictures differ in size (%s px). "
            "Give pictures that were not resized, rotated or cropped, or --lens NAME=camera.json "
            "for each camera.",
            sizes,
        )


Covariances = "np.ndarray | dict[str, np.ndarray] | None"


def read_lenses(
    arguments: tuple[str, ...], cameras: Iterable[str]
) -> "tuple[dict[str, trinoc.Intrinsics], Covariances]":
    """Read the lens of each camera and the covariances of the lenses.

    Parameters
    ----------
    arguments : tuple of str
        One file for all cameras, or NAME=FILE for each.
    cameras : iterable of str
        Names of the cameras.

    Returns
    -------
    lenses : dict of Intrinsics
        Lens of each camera that has a file.
    covariances
        Covariance of the common lens, or of each camera's lens, as far as the files contain them.

    Raises
    ------
    UsageError
        If an argument has the wrong form.
    InputError
        If a file contains no lens.
    """
    import equinox as eqx

    from trinoc.io.rig_json import load_lens

    is_of_all = len(arguments) == 1 and "=" not in arguments[0]
    files = dict.fromkeys(cameras, Path(arguments[0])) if is_of_all else files_of_views(arguments)
    stated_lenses = {name: load_lens(file, name) for name, file in files.items()}
    lenses = {name: lens.intrinsics for name, lens in stated_lenses.items()}
    stated = {
        name: lens.covariance for name, lens in stated_lenses.items() if lens.covariance is not None
    }
    if is_of_all and eqx.tree_equal(*lenses.values()):
        return lenses, next(iter(stated.values()), None)
    return lenses, stated or None


class LensOptions(NamedTuple):
    """Options of the lens: files (--lens), or numbers of a data sheet (--lens-mm)."""

    lens: tuple[str, ...] = ()
    lens_mm: tuple[float, float, float] = NO_NUMBERS

    def check(self) -> None:
        """Raise UsageError if the options are invalid. No image is read."""
        if self.lens_mm != NO_NUMBERS:
            expect_focal_length(self.lens_mm[0])
            expect_pixel_pitch(self.lens_mm[1:], "--lens-mm has pixels of")

    def lenses(self, sizes_px: Mapping[str, tuple[int, int]]) -> "dict[str, trinoc.Intrinsics]":
        """Return the lens of each camera.

        Raises UsageError if the options do not determine the lens, and InputError for an invalid
        file.

        sizes_px : (width, height) of each camera's images.
        """
        from trinoc.io.intrinsics_json import expect_lens

        by_numbers = self.lens_mm != NO_NUMBERS
        if by_numbers and self.lens:
            raise UsageError("Both --lens and --lens-mm are given: give one of them.")
        if not by_numbers and not self.lens:
            raise UsageError(
                "The lens is missing: give either --lens camera.json, or --lens-mm FOCAL WIDTH "
                "HEIGHT."
            )
        if by_numbers:
            focal_mm, width_mm, height_mm = self.lens_mm
            _warn_of_sizes(sizes_px)
            return {
                name: expect_lens(
                    trinoc.Intrinsics(
                        focal_length_mm=focal_mm,
                        pixel_pitch_mm=(width_mm, height_mm),
                        image_size_px=size,
                    ),
                    "The lens of --lens-mm",
                )
                for name, size in sizes_px.items()
            }
        lenses, _ = read_lenses(self.lens, sizes_px)
        warn_of_folds(lenses, "--lens")
        for name in sizes_px:
            if name not in lenses:
                raise UsageError(
                    f'--lens has no file for the camera "{name}": add {name}=camera.json.'
                )
        return {name: lenses[name] for name in sizes_px}

    def covariance(
        self, lenses: "Mapping[str, trinoc.Intrinsics]"
    ) -> "np.ndarray | Mapping[str, np.ndarray] | None":
        """Covariance of the lens of all cameras, or of each camera's lens; None if all are exact.

        A lens whose file states no covariance, or a lens of --lens-mm, has the covariance of
        `Systematics.typical`.
        """
        typical = trinoc.Systematics.typical(lenses).lens_covariance
        if not self.lens:
            return typical
        _, stated = read_lenses(self.lens, lenses)
        if isinstance(stated, Mapping):
            of_lenses = {name: matrix for name, matrix in stated.items() if name in lenses}
            return {**(typical if isinstance(typical, Mapping) else {}), **of_lenses} or None
        return typical if stated is None else stated

    def files(self) -> dict[str, Path]:
        """Files that `lenses` reads, by name, for the provenance."""
        if len(self.lens) == 1 and "=" not in self.lens[0]:
            return {"lens": Path(self.lens[0])}
        return {f"lens {k}": v for k, v in files_of_views(self.lens).items()}
