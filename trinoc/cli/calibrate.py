"""`trinoc calibrate`: one picture of the sheet per camera to a rig.json."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import (
    LOGGER,
    BoardFile,
    Command,
    DryRunOption,
    Out,
    Outcome,
    ReportOption,
    UsageError,
)
from trinoc.cli.lens_options import SIGMA, LensOptions, print_systematics
from trinoc.cli.settings import Settings, read_settings
from trinoc.cli.views import files_of_views
from trinoc.errors import CalibrationError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.calib.targets.pattern import Pattern
    from trinoc.calib.uncertainty.systematics import Systematics
    from trinoc.geometry.intrinsics import Intrinsics


# Of bars that somebody measured without saying how well: a ruler.
MEASURED = (5e-4, 5e-4)


@dataclasses.dataclass(frozen=True, kw_only=True)
class CalibrateCommand(DryRunOption, ReportOption, Command):
    """Calibrate cameras from one picture of the printed sheet each."""

    images: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME=IMG", help_behavior_hint="(required)"),
    ]
    """The picture that each camera took of the sheet, such as upper=upper.png left=left.png."""

    board: BoardFile
    """Layout of the sheet (JSON), as `trinoc pattern` writes it."""

    lens: LensOptions

    print_scale: Annotated[
        tuple[float, float] | None,
        tyro.conf.arg(metavar="X Y", help_behavior_hint="(default: not measured)"),
    ] = None
    """Measured over nominal length of the sheet's two scale bars."""

    sigma: Settings = ()
    """Standard deviations of what is not exact, 0 for what is: print_scale=0.002 (of both bars, or
    X,Y; 0.0005 if measured), flatness_mm=0.3 (of the sheet at its edge), aim_mm=20 (from the
    sheet's origin to the optical axes, with the pose model aimed; 0 as in the paper), lens=0 (for a
    lens that is exactly what is said of it)."""

    method: Literal["pixels", "points"] = "pixels"
    """pixels: the grey levels of each picture count where its circles agree; points: the circles
    alone."""

    bayer: Annotated[
        Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None,
        tyro.conf.arg(metavar="RGGB|BGGR|GRBG|GBRG", help_behavior_hint="(default: none)"),
    ] = None
    """The pictures are raw mosaics of these colours: each pixel is fitted as it is."""

    response: Literal["linear", "srgb", "fit"] = "fit"
    """Of the cameras: how grey levels stand for light. fit: linear, until the edges of the sheet
    refute it, then as they show it."""

    orientation: Annotated[
        str | None, tyro.conf.arg(metavar="upright|RIG", help_behavior_hint="(default: refuse)")
    ] = None
    """Which way round a sheet lies that looks the same turned: upright, where X points right in
    every picture, or as the cameras of an earlier rig.json saw it."""

    pose_model: Literal["aimed", "aim-free"] = "aimed"
    """aimed: the optical axis meets the origin of the sheet; aim-free: where it meets the sheet is
    free."""

    out: Out = Path("rig.json")
    """Where the rig goes."""

    accept_suspect: bool = False
    """Write the rig also where the calibration of a camera is SUSPECT; the file then says so."""

    def run(self, command_line: str) -> Outcome:
        """Calibrate and write the rig."""
        sigma = read_settings("--sigma", self.sigma, SIGMA)
        files = files_of_views(self.images, guess=True)
        if not files:
            raise UsageError("No picture is given: write NAME=FILE for each camera.")
        scale = self.print_scale or (1.0, 1.0)
        if not all(0.9 < each < 1.1 for each in scale):
            raise UsageError(
                "--print-scale is a measured over a nominal length: give a number near 1, such as "
                "1.001, for X and for Y."
            )
        self.lens.check()
        if self.orientation not in (None, "upright") and not Path(self.orientation).is_file():
            raise UsageError(
                f"--orientation is {self.orientation}: give upright, or the file of an earlier rig."
            )

        from trinoc.calib.sheet_calibration import calibrate
        from trinoc.cli.command import provenance
        from trinoc.geometry.rig import Rig
        from trinoc.io.atomic import expect_place
        from trinoc.io.board_json import load_pattern
        from trinoc.io.images import read_views
        from trinoc.io.rig_json import load_rig
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out, self.report)
        expect_replaceable(self.out, Rig, force=self.force)
        pattern = load_pattern(self.board).rescale(*scale)
        images = read_views(files)
        lenses = self.lens.lenses({name: _size(image) for name, image in images.items()})
        known = self._systematics(lenses, sigma)
        earlier = None if self.orientation in (None, "upright") else load_rig(self.orientation)
        if self.dry_run:
            sizes = {name: _size(image) for name, image in images.items()}
            return self.plan(f"calibrate by {pattern.name}", files, sizes, (self.out, self.report))
        LOGGER.info("calibrating %s", ", ".join(files))
        origin = provenance(command_line, {**files, "board": self.board, **self.lens.files()})
        try:
            result = calibrate(
                images,
                pattern,
                lenses,
                pose_model=self.pose_model,
                method=self.method,
                bayer=self.bayer,
                response=self.response,
                systematics=known,
                orientation="upright" if self.orientation == "upright" else earlier,
            )
        except CalibrationError as error:
            raise kept_of_failure(
                error,
                images,
                pattern,
                self.out,
                refusal=lambda found: None if self.accept_suspect else suspicion(found, self.out),
                provenance=origin,
            ) from error
        included = ["noise", *result.systematics]
        refusal = None if self.accept_suspect else suspicion(result, self.out)
        if refusal is None:
            save(
                result, self.out, provenance={**origin, "sigmas_include": included}, overwrite=True
            )
        self.write_report(origin, result=result, sheet_pictures=images, title="Calibration")
        written = self.out if refusal is None else None, self.report
        return Outcome(result.summary(), calibration_record(result), refusal, written)

    def _systematics(
        self, lenses: "dict[str, Intrinsics]", sigma: "Mapping[str, Any]"
    ) -> "Systematics":
        """What is not exact: as said, else as it usually is."""
        from trinoc.calib.uncertainty.systematics import Systematics

        usual = Systematics.typical(lenses)._replace(
            lens_covariance=None if "lens" in sigma else self.lens.covariance(lenses)
        )
        if self.print_scale is not None:
            usual = usual._replace(print_scale_sigma=MEASURED, print_size_sigma=0.0)
        if "aim_mm" in sigma:
            usual = usual._replace(aim_sigma_mm=sigma["aim_mm"])
        return usual._replace(**print_systematics(sigma))


def suspicion(result: "CalibrationResult", out: Path) -> str | None:
    """Why the rig is not written unless that is wanted; None where no camera is suspect."""
    from trinoc.calib.result.calibration import Status

    suspects = [name for name, status in result.status.items() if status is Status.SUSPECT]
    if not suspects:
        return None
    why = result.fits[suspects[0]].notes[0].removesuffix(".")
    return (
        f'The calibration of "{suspects[0]}" is SUSPECT ({why}), so {out} was not written: mend '
        "what is named, or take it all the same with --accept-suspect."
    )


def calibration_record(result: "CalibrationResult") -> dict[str, Any]:
    """What programs want to know of a calibration, as JSON can hold it."""
    return {
        "cameras": {
            name: {
                "status": status.name.lower(),
                "method": result.fits[name].method,
                "parameters": {
                    parameter.rpartition(".")[2]: {
                        "value": float(value),
                        "sigma": result.rig.sigma(parameter),
                    }
                    for parameter, value in zip(result.parameters, result.values, strict=True)
                    if parameter.rpartition(".")[0] == name
                },
                "circles": int(result.fits[name].used.sum()),
                "rms_px": result.fits[name].rms_px,
                "reduced_chi_square": result.fits[name].reduced_chi_square,
                "notes": list(result.fits[name].notes),
            }
            for name, status in result.status.items()
        },
        "sigmas_include": ["noise", *result.systematics],
        "notes": list(result.notes),
        "advice": result.advice or None,
    }


def _size(image: Any) -> tuple[int, int]:
    return image.shape[1], image.shape[0]


def kept_of_failure(
    error: CalibrationError,
    images: "Mapping[str, np.ndarray]",
    pattern: "Pattern",
    out: Path,
    *,
    refusal: Callable[["CalibrationResult"], str | None],
    provenance: Mapping[str, Any],
) -> CalibrationError:
    """The same error, which also says what was written beside `out`.

    `out` itself stays as it is: an incomplete rig must not take the place of a whole one.

    refusal : why what is known of the others may not be written, if so.
    """
    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.capture.annotated import failure_picture
    from trinoc.capture.judgement import judge
    from trinoc.io.atomic import as_file_name
    from trinoc.io.images import write_picture
    from trinoc.io.saving import save

    said = [str(error)]
    for name in error.failures:
        faults = judge(name, images[name], pattern).faults
        place = out.with_name(f"{out.stem}-{as_file_name(name)}-failed.png")
        write_picture(place, failure_picture(images[name], [error.failures[name], *faults]))
        causes = f" (there {'; '.join(faults)})" if faults else ""
        said.append(f'What was seen of "{name}" is in {place}{causes}.')
    result = error.result
    if isinstance(result, CalibrationResult):
        why = refusal(result)
        place = out.with_name(f"{out.stem}-incomplete.json")
        if why is None:
            save(result, place, provenance=provenance, overwrite=True)
            others = ", ".join(result.rig.names)
            kept = "is as it was" if out.exists() else "was not written"
            why = f"{place} holds the others ({others}); {out} {kept}."
        said.append(why)
    return CalibrationError(" ".join(said), error.failures, result)
