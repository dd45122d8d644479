"""How the command line says what lens a camera has."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from trinoc.cli.command import UsageError
from trinoc.cli.views import files_of_views
from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.geometry.intrinsics import Intrinsics

# Not None: an option that may be a pair or nothing would take pictures that follow it.
NOT_GIVEN = (0.0, 0.0)
# From an endoscope's lens to a telescope.
FOCAL_RANGE_MM = (0.1, 10_000.0)

# The same option wherever a command asks for it.
PixelPitch = Annotated[
    tuple[float, float], tyro.conf.arg(metavar="WIDTH HEIGHT", help_behavior_hint="(optional)")
]


def expect_pixel_pitch(pitch_mm: tuple[float, float]) -> None:
    """Raise UsageError for a pitch that no sensor has, before any picture is read."""
    from trinoc.io.usable_cameras import expect_pitch

    try:
        expect_pitch(None if pitch_mm == NOT_GIVEN else pitch_mm, "--pixel-pitch-mm is")
    except InputError as error:
        raise UsageError(str(error)) from error


def expect_focal_length(focal_length_mm: float | None) -> None:
    """Raise UsageError for a focal length in another unit than mm, before any picture is read."""
    if focal_length_mm is None:
        return
    shortest, longest = FOCAL_RANGE_MM
    for unit, factor in (("metres", 1e3), ("micrometres", 1e-3)):
        meant = focal_length_mm * factor
        wrong = 0 < focal_length_mm < shortest if factor > 1 else focal_length_mm > longest
        if wrong and shortest <= meant <= longest:
            raise UsageError(
                f"--focal-length-mm is {focal_length_mm:g} mm, which looks like {unit}: write "
                f"{meant:g} millimetres."
            )


@dataclasses.dataclass(frozen=True)
class LensOptions:
    """The lens: from a file, or as its data sheet has it."""

    intrinsics: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="FILE", help_behavior_hint="(or the two options below)"),
    ] = ()
    """camera.json of all cameras, or NAME=camera.json, once for each."""

    focal_length_mm: Annotated[
        float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="(with the next)")
    ] = None
    """Focal length of all cameras, instead of --intrinsics."""

    pixel_pitch_mm: PixelPitch = NOT_GIVEN
    """Width and height of a pixel in mm; both, also where they are equal."""

    lens_covariance: Annotated[
        bool,
        tyro.conf.arg(
            help="Leave the covariance that a camera.json states out of the cameras' sigmas.",
            help_behavior_hint="(default: it counts)",
        ),
    ] = True

    lens_exact: bool = False
    """Take the lens as exactly what is said of it. Without it, one from a data sheet may be off by
    1 % in focal length, 2 % of the picture's width in the principal point, and one pixel of
    distortion at the corner."""

    def lenses(self, sizes_px: Mapping[str, tuple[int, int]]) -> "dict[str, Intrinsics]":
        """The lens of each camera, whose pictures have these (width, height).

        Raises UsageError where the options do not say it, InputError for a file that does not.
        """
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.io.intrinsics_json import load_intrinsics
        from trinoc.io.usable_cameras import expect_lens

        by_numbers = self.focal_length_mm is not None or self.pixel_pitch_mm != NOT_GIVEN
        if by_numbers == bool(self.intrinsics):
            raise UsageError(
                "The lens is not determined: give either --intrinsics, or --focal-length-mm and "
                "--pixel-pitch-mm."
            )
        if by_numbers:
            if self.focal_length_mm is None or self.pixel_pitch_mm == NOT_GIVEN:
                raise UsageError(
                    "The lens is not determined: --focal-length-mm MM and --pixel-pitch-mm WIDTH "
                    "HEIGHT go together."
                )
            return {
                name: expect_lens(
                    Intrinsics(
                        focal_length_mm=self.focal_length_mm,
                        pixel_pitch_mm=self.pixel_pitch_mm,
                        image_size_px=size,
                    ),
                    "The lens of --focal-length-mm and --pixel-pitch-mm",
                )
                for name, size in sizes_px.items()
            }
        if len(self.intrinsics) == 1 and "=" not in self.intrinsics[0]:
            lens = load_intrinsics(Path(self.intrinsics[0]))
            return dict.fromkeys(sizes_px, lens)
        files = files_of_views(self.intrinsics)
        for name in sizes_px:
            if name not in files:
                raise UsageError(
                    f'--intrinsics has no file for the camera "{name}": add {name}=camera.json.'
                )
        return {name: load_intrinsics(files[name]) for name in sizes_px}

    def covariance(
        self, lenses: "Mapping[str, Intrinsics]"
    ) -> "np.ndarray | Mapping[str, np.ndarray] | None":
        """The covariance of the one lens of all cameras, or of each that is not exact, if any.

        What no file states is that of a data sheet, where the lens is given as one gives it.
        """
        from trinoc.calib.uncertainty.systematics import Systematics
        from trinoc.io.intrinsics_json import load_lens_covariance

        if self.lens_exact or (self.intrinsics and not self.lens_covariance):
            return None
        usual = Systematics.typical(lenses).lens_covariance
        if not self.intrinsics:
            return usual
        if len(self.intrinsics) == 1 and "=" not in self.intrinsics[0]:
            stated = load_lens_covariance(Path(self.intrinsics[0]))
            return usual if stated is None else stated
        files = files_of_views(self.intrinsics)
        loaded = {name: load_lens_covariance(files[name]) for name in lenses}
        stated = {name: each for name, each in loaded.items() if each is not None}
        return {**(usual if isinstance(usual, Mapping) else {}), **stated} or None

    def files(self) -> dict[str, Path]:
        """The files that `lenses` reads, for provenance."""
        if len(self.intrinsics) == 1 and "=" not in self.intrinsics[0]:
            return {"intrinsics": Path(self.intrinsics[0])}
        return {f"intrinsics {k}": v for k, v in files_of_views(self.intrinsics).items()}
