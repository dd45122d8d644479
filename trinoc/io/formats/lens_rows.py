"""Conversion of lenses between trinoc and other tools, by a table of lens models for each format.

A model with a name in both has the same polynomial. Formats differ in the order and number of the
coefficients, and in the pixel origin.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import LENS_MODELS
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.rig import Rig

# What rounding leaves where a projection matrix was taken apart.
NEGLIGIBLE_SKEW_PX = 1e-9


class LensRow(NamedTuple):
    """A lens model of another format: one row of the format's table of models.

    Attributes
    ----------
    called : str
        Name of the model in the format.
    model : str
        Name of the model in trinoc.
    coefficients : tuple of str
        Names of the coefficients, in the order of the format. A name that the trinoc model does not
        have must have the value 0.
    """

    called: str
    model: str
    coefficients: tuple[str, ...]


class LensNumbers(NamedTuple):
    """The parameters of a lens as another format stores them.

    Attributes
    ----------
    called : str
        Name of the model in the format.
    focal_px : tuple
        Focal lengths along u and v.
    centre_px : tuple
        Principal point (u, v), relative to the pixel origin of the format.
    skew_px : float
        Entry K[0, 1] of the calibration matrix.
    coefficients : list of float
        Distortion coefficients, in the order of the format.
    """

    called: str
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    skew_px: float
    coefficients: list[float]


def list_lenses(rig: Rig) -> dict[str, Intrinsics]:
    """The lens of each camera, keyed by camera name."""
    return {name: camera.intrinsics for name, camera in rig.items()}


def list_lens_numbers(
    lens: Intrinsics,
    rows: Sequence[LensRow],
    title: str,
    camera: str = "",
    *,
    origin_px: float = 0.0,
    skew: bool = False,
) -> LensNumbers:
    """Convert a lens to the parameters of another format.

    Parameters
    ----------
    lens : Intrinsics
        The lens.
    rows : sequence of LensRow
        Models of the format. The first row that can represent the lens is used.
    title : str
        Name of the format in messages.
    camera : str
        Name of the camera in messages, if any.
    origin_px : float
        Coordinate, in the format, of the centre of the top-left pixel.
    skew : bool
        True if the format stores a skew.

    Returns
    -------
    LensNumbers

    Raises
    ------
    InputError
        If no row can represent the lens, or the lens has a skew that the format does not store.
    """
    who = f'The lens of "{camera}"' if camera else "The lens"
    if not skew and abs(float(lens.skew_px)) > NEGLIGIBLE_SKEW_PX:
        raise InputError(
            f"{who} has a skew of {float(lens.skew_px):g} px, which {title} cannot contain: export "
            "to matlab, which supports skew."
        )
    values = dict(
        zip(
            lens.lens.coefficient_names,
            np.asarray(lens.lens.coefficients, np.float64).tolist(),
            strict=True,
        )
    )
    ideal = lens.lens.zero_is_ideal and not any(values.values())
    fitting = [row for row in rows if row.model == lens.lens.model] or [
        row for row in rows if ideal and LENS_MODELS[row.model].zero_is_ideal
    ]
    if not fitting:
        advice = "choose another"
        if isinstance(lens.lens, AbstractSplinedLens):
            advice = (
                "the formats of other tools cannot contain splines; to export this camera, "
                f"calibrate with the lens model {lens.lens.core_model.model}"
            )
        raise InputError(
            f"{who} has the lens model {lens.lens.model}, which {title} cannot contain: {advice}."
        )
    for row in fitting:
        unsupported = [
            name for name, value in values.items() if value and name not in row.coefficients
        ]
        if not unsupported:
            break
    else:
        raise InputError(
            f"{who} has {unsupported[0]} = {values[unsupported[0]]:g}, which {title} cannot "
            "contain: choose another format, or calibrate the lens without this parameter."
        )
    focal, centre = np.asarray(lens.focal_length_px), np.asarray(lens.principal_point_px)
    return LensNumbers(
        row.called,
        (float(focal[0]), float(focal[1])),
        (float(centre[0]) + origin_px, float(centre[1]) + origin_px),
        float(lens.skew_px),
        [values.get(name, 0.0) for name in row.coefficients],
    )


def make_lens(
    numbers: LensNumbers,
    image_size_px: tuple[int, int],
    rows: Sequence[LensRow],
    where: str,
    *,
    origin_px: float = 0.0,
) -> Intrinsics:
    """Convert the parameters of another format to a lens.

    Parameters
    ----------
    numbers : LensNumbers
        Parameters as the format stores them.
    image_size_px : (width, height)
        Size of the images.
    rows : sequence of LensRow
        Models of the format.
    where : str
        Beginning of the error message: the file, and the camera in the file.
    origin_px : float
        Coordinate, in the format, of the centre of the top-left pixel.

    Returns
    -------
    Intrinsics
        A lens without distortion if all coefficients are zero and the model allows it.

    Raises
    ------
    InputError
        If trinoc does not have the model or a coefficient, or if the numbers do not describe a
        lens.
    """
    rows_of_model = [row for row in rows if row.called == numbers.called]
    if not rows_of_model:
        model_names = ", ".join(dict.fromkeys(row.called for row in rows))
        raise InputError(
            f'{where} has the lens model "{numbers.called}", but trinoc reads {model_names} here: '
            "convert the lens first."
        )
    largest_count = max(len(row.coefficients) for row in rows_of_model)
    if len(numbers.coefficients) > largest_count:
        raise InputError(
            f"{where} has {len(numbers.coefficients)} distortion coefficients, but "
            f"{numbers.called or 'its model'} has {largest_count}: check the file."
        )
    # The first row, the simplest lens, that knows what is not zero.
    row = next((row for row in rows_of_model if not _unknown(numbers, row)), rows_of_model[-1])
    coefficients = dict(zip(row.coefficients, numbers.coefficients))
    ours = LENS_MODELS[row.model].coefficient_names
    for name in _unknown(numbers, row):
        raise InputError(
            f"{where} has {name} = {coefficients[name]:g}, which trinoc's lens {row.model} does "
            "not have: convert the lens first."
        )
    if not all(focal > 0 for focal in numbers.focal_px):
        raise InputError(
            f"{where} has the focal lengths {numbers.focal_px[0]:g} and {numbers.focal_px[1]:g} "
            "px, but both must be positive: correct them."
        )
    distorted = any(coefficients.values()) or not LENS_MODELS[row.model].zero_is_ideal
    return Intrinsics(
        image_size_px=image_size_px,
        focal_length_px=numbers.focal_px,
        principal_point_px=tuple(c - origin_px for c in numbers.centre_px),
        skew_px=numbers.skew_px,
        distortion=[coefficients.get(name, 0.0) for name in ours] if distorted else None,
        distortion_model=row.model if distorted else None,
    )


def _unknown(numbers: LensNumbers, row: LensRow) -> list[str]:
    """Names of non-zero coefficients that the trinoc model of a row does not have."""
    ours = LENS_MODELS[row.model].coefficient_names
    beyond = [
        f"coefficient {k + 1}" for k in range(len(row.coefficients), len(numbers.coefficients))
    ]
    names = (*row.coefficients, *beyond)
    return [name for name, value in zip(names, numbers.coefficients) if value and name not in ours]
