"""`trinoc intrinsics`: several pictures of the sheet by one camera to a camera.json."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import LOGGER, BoardFile, Command, Out, Outcome, UsageError, each
from trinoc.cli.lens_options import expect_pixel_pitch

if TYPE_CHECKING:
    from trinoc.calib.intrinsics_result import IntrinsicsResult


# Not None: an option that may be a pair or nothing would take pictures that follow it.
NO_PITCH = (0.0, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class IntrinsicsCommand(Command):
    """Find focal length, principal point and distortion from several pictures of the sheet."""

    images: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="IMG", help_behavior_hint="(required)"),
    ]
    """Pictures by one camera at one zoom and focus, the sheet held differently in each."""

    board: BoardFile
    """Layout of the sheet (JSON), as `trinoc pattern` writes it."""

    lens_model: Literal[
        "brown_conrady",
        "rational",
        "thin_prism",
        "kannala_brandt",
        "splined",
        "splined_brown_conrady",
        "splined_rational",
        "splined_kannala_brandt",
    ] = "brown_conrady"
    """Model of the lens; splined is brown_conrady corrected by B-splines, for a lens that no
    polynomial describes."""

    distortion: Annotated[
        int | None,
        tyro.conf.arg(metavar="N", help_behavior_hint="(default: all that are determined)"),
    ] = None
    """Number of coefficients of that model; of brown_conrady, of k1, k2, p1, p2, k3."""

    pixel_pitch_mm: Annotated[
        tuple[float, float],
        tyro.conf.arg(metavar="WIDTH HEIGHT", help_behavior_hint="(optional)"),
    ] = NO_PITCH
    """Width and height of a pixel in mm; both, also where they are equal."""

    hold: Annotated[
        tuple[Literal["principal-point", "aspect"], ...],
        tyro.conf.arg(metavar="principal-point|aspect...", help_behavior_hint="(default: none)"),
    ] = ()
    """What is not fitted: principal-point is held in the middle of the picture, aspect (the ratio
    of both focal lengths) at that of the pixels."""

    method: Literal["points", "pixels"] = "points"
    """Fit the circles' centres, or go on from there to the grey levels near every edge."""

    out: Out = Path("camera.json")
    """Where the lens goes."""

    def run(self, command_line: str) -> Outcome:
        """Calibrate the lens and write it."""
        if not self.images:
            raise UsageError("No picture is given: give several pictures of the sheet.")
        pitch_mm = None if self.pixel_pitch_mm == NO_PITCH else self.pixel_pitch_mm
        expect_pixel_pitch(pitch_mm, "--pixel-pitch-mm is")

        from trinoc.calib.lens_calibration import calibrate_intrinsics
        from trinoc.cli.command import provenance
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.io.atomic import expect_place
        from trinoc.io.board_json import load_pattern
        from trinoc.io.images import read_image
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out)
        expect_replaceable(self.out, Intrinsics, force=self.force)
        pattern = load_pattern(self.board)
        images = [read_image(path) for path in each(self.images, "reading", quiet=self.quiet)]
        LOGGER.info("calibrating the lens of %d pictures", len(images))
        result = calibrate_intrinsics(
            images,
            pattern,
            distortion=self.distortion,
            lens_model=self.lens_model,
            principal_point="centre" if "principal-point" in self.hold else "free",
            pixel_pitch_mm=pitch_mm,
            aspect="pitch" if "aspect" in self.hold else "free",
            method=self.method,
        )
        inputs = {f"picture {k + 1}": path for k, path in enumerate(self.images)}
        save(
            result,
            self.out,
            provenance=provenance(command_line, {**inputs, "board": self.board}),
        )
        return Outcome(result.summary(), intrinsics_record(result), written=(self.out,))


def intrinsics_record(result: "IntrinsicsResult") -> dict[str, Any]:
    """What programs want to know of a lens, as JSON can hold it."""
    advice = result.next_image
    return {
        "parameters": {
            name: {"value": float(value), "sigma": result.sigma(name), "free": name in result.free}
            for name, value in zip(result.parameters, result.values, strict=True)
        },
        "pictures": len(result.detections),
        "failures": {str(index + 1): why for index, why in result.failures.items()},
        "circles": sum(int(used.sum()) for used in result.used),
        "rms_px": result.rms_px,
        "reduced_chi_square": result.reduced_chi_square,
        "largest_sigma_px": float(result.field_sigma_px.max()),
        "notes": list(result.notes),
        "next_picture": None if advice is None else advice.sentence,
    }
