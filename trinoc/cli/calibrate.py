"""`trinoc calibrate`: one picture of the sheet per camera to a rig.json."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import trinoc
from trinoc.cli.command import LOGGER, Job, Outcome, UsageError, pick, plan_outcome
from trinoc.cli.lens_options import NO_NUMBERS, SIGMA, LensOptions, print_systematics
from trinoc.cli.options import Settings
from trinoc.cli.settings import read_settings
from trinoc.cli.views import named_files
from trinoc.errors import CalibrationError

if TYPE_CHECKING:
    import numpy as np

# Of bars that somebody measured without saying how well: a ruler.
MEASURED = (5e-4, 5e-4)


def calibrate(
    images: tuple[str, ...],
    /,
    *,
    board: Path,
    lens: tuple[str, ...] = (),
    lens_mm: tuple[float, float, float] = NO_NUMBERS,
    print_scale: tuple[float, float] | None = None,
    sigma: Settings = (),
    method: Literal["pixels", "points"] = "pixels",
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None,
    response: Literal["linear", "srgb", "fit"] = "fit",
    orientation: str | None = None,
    pose_model: Literal["aimed", "aim-free"] = "aimed",
    dry_run: bool = False,
    report: Path | None = None,
    out: Path = Path("rig.json"),
    accept_suspect: bool = False,
    job: Job,
) -> Outcome:
    """Calibrate cameras from one image each of the printed sheet.

    Parameters
    ----------
    images : NAME=IMG
        The image of the sheet from each camera, such as upper=upper.png left=left.png.
    board
        Layout of the sheet (JSON), as `trinoc pattern` writes it.
    lens : FILE (or --lens-mm)
        Calibrated lenses: camera.json or rig.json for all cameras, or NAME=camera.json for each.
    lens_mm : FOCAL WIDTH HEIGHT (or --lens)
        Data sheet of the lens of all cameras: focal length, width and height of one pixel, in mm.
        The calibration assumes standard deviations of 1 % for the focal length, 2 % of the image
        width for the principal point, and one pixel of distortion at the image corner, unless
        --sigma has lens=0.
    print_scale : X Y (default: not measured)
        Scale of the print: measured length over nominal length of the two scale bars.
    sigma
        Standard deviations of what is not exact; 0 means exact. print_scale=0.002 (both bars, or
        X,Y; 0.0005 if measured), flatness_mm=0.3 (of the sheet at its edge), aim_mm=20 (distance of
        the optical axes from the origin of the sheet, with the pose model aimed; 0 as in the
        paper), lens=0 (the given lens is exact).
    method
        points: fit the circles alone. pixels: fit the grey levels of each image, too, and use them
        if they agree with the circles.
    bayer
        The images are raw Bayer mosaics of this layout. Every pixel is used without demosaicing.
    response
        Response of the cameras: grey level as a function of light. fit: linear, or the response
        that the sheet's edges show if they contradict a linear one.
    orientation : upright|RIG (default: refuse ambiguous sheets)
        Orientation of a sheet that looks the same after a rotation. upright: X points to the right
        in every image. RIG: as an earlier rig.json has it.
    pose_model
        aimed: the optical axis passes through the origin of the sheet. aim-free: the point where
        the axis meets the sheet is estimated.
    dry_run
        Read and check all inputs, report what the command would do, and write nothing.
    report
        Write an HTML report to this file, too: verdict, cameras, residuals, uncertainty over the
        field, and matches.
    out
        File of the calibrated rig.
    accept_suspect
        Write the rig even if the calibration of a camera is SUSPECT. The file records the status.
    """
    sigmas = read_settings("--sigma", sigma, SIGMA)
    files = named_files(images)
    scale = print_scale or (1.0, 1.0)
    if not all(0.9 < each < 1.1 for each in scale):
        raise UsageError(
            "--print-scale is the measured length divided by the nominal length: give a number "
            "near 1, such as 1.001, for X and for Y."
        )
    lens_options = LensOptions(lens, lens_mm)
    lens_options.check()
    if orientation not in (None, "upright") and not Path(orientation).is_file():
        raise UsageError(
            f"--orientation is {orientation}: give upright, or the file of an earlier rig."
        )

    job.expect(trinoc.Rig, out, report)
    pattern = trinoc.load_pattern(board).rescale(*scale)
    pictures = trinoc.io.read_views(files)
    sizes = {name: (image.shape[1], image.shape[0]) for name, image in pictures.items()}
    lenses = lens_options.lenses(sizes)
    # What is not exact: as stated, else as it usually is.
    systematics = trinoc.Systematics.typical(lenses)._replace(
        lens_covariance=None if "lens" in sigmas else lens_options.covariance(lenses)
    )
    if print_scale is not None:
        systematics = systematics._replace(print_scale_sigma=MEASURED, print_size_sigma=0.0)
    if "aim_mm" in sigmas:
        systematics = systematics._replace(aim_sigma_mm=sigmas["aim_mm"])
    systematics = systematics._replace(**print_systematics(sigmas))
    earlier = trinoc.load_rig(orientation) if orientation not in (None, "upright") else orientation
    if dry_run:
        return plan_outcome(f"calibrate by {pattern.name}", files, sizes, (out, report))
    LOGGER.info("calibrating %s", ", ".join(files))
    provenance = job.provenance({**files, "board": board, **lens_options.files()})

    def refuse(result: "trinoc.calib.CalibrationResult") -> str | None:
        return None if accept_suspect else _suspicion(result, out)

    try:
        result = trinoc.calibrate(
            pictures,
            pattern,
            lenses,
            pose_model=pose_model,
            method=method,
            bayer=bayer,
            response=response,
            systematics=systematics,
            orientation=earlier,  # pyright: ignore[reportArgumentType]
        )
    except CalibrationError as error:
        raise _keep_of_failure(error, pictures, pattern, out, refuse, provenance) from error
    included = {"sigmas_include": ["noise", *result.systematics]}
    refusal = refuse(result)
    if refusal is None:
        trinoc.save(result, out, provenance={**provenance, **included}, overwrite=True)
    job.write_report(
        report, provenance, result=result, sheet_pictures=pictures, title="Calibration"
    )
    written = out if refusal is None else None, report
    return Outcome(result.summary(), calibration_record(result), refusal, written)


def _suspicion(result: "trinoc.calib.CalibrationResult", out: Path) -> str | None:
    """Return the reason why a rig with a suspect camera is not written; else None."""
    suspects = [
        name for name, status in result.status.items() if status is trinoc.calib.Status.SUSPECT
    ]
    if not suspects:
        return None
    reason = result.fits[suspects[0]].notes[0].removesuffix(".")
    return (
        f'The calibration of "{suspects[0]}" is SUSPECT ({reason}), so {out} was not written: '
        "correct the cause, or accept the result with --accept-suspect."
    )


def calibration_record(result: "trinoc.calib.CalibrationResult") -> dict[str, Any]:
    """Summary of a calibration as a JSON object."""
    parameters: dict[str, dict[str, Any]] = {name: {} for name in result.status}
    for parameter, value in zip(result.parameters, result.values, strict=True):
        name, _, short = parameter.rpartition(".")
        if name in parameters:
            sigma = result.rig.sigma(parameter)
            parameters[name][short] = {"value": float(value), "sigma": sigma}
    return {
        "cameras": {
            name: {
                "status": status.name.lower(),
                "method": result.fits[name].method,
                "parameters": parameters[name],
                "circles": int(result.fits[name].used.sum()),
                **pick(result.fits[name], "rms_px", "reduced_chi_square", "notes"),
            }
            for name, status in result.status.items()
        },
        "sigmas_include": ["noise", *result.systematics],
        "notes": list(result.notes),
        "advice": result.advice or None,
    }


def _keep_of_failure(
    error: CalibrationError,
    pictures: "Mapping[str, np.ndarray]",
    pattern: "trinoc.Pattern",
    out: Path,
    refuse: Callable[["trinoc.calib.CalibrationResult"], str | None],
    provenance: Mapping[str, Any],
) -> CalibrationError:
    """Write what a failed calibration produced, and return the error with sentences about these
    files.

    The rig of the other cameras is written to a separate file, so that it does not replace a
    complete rig in `out`.

    pictures : images by camera.
    refuse : function that returns the reason why the rig of the other cameras may not be written,
        or None.
    """
    from trinoc.capture.annotated import failure_picture
    from trinoc.capture.image_quality import measure_quality
    from trinoc.io.atomic import as_file_name

    sentences = [str(error)]
    for name, failure in error.failures.items():
        faults = measure_quality(name, pictures[name], pattern).faults
        path = out.with_name(f"{out.stem}-{as_file_name(name)}-failed.png")
        trinoc.io.write_picture(path, failure_picture(pictures[name], [failure, *faults]))
        causes = f" (possible causes: {'; '.join(faults)})" if faults else ""
        sentences.append(f'The detected points of "{name}" are drawn in {path}{causes}.')
    result = error.result
    if isinstance(result, trinoc.calib.CalibrationResult):
        sentence = refuse(result)
        if sentence is None:
            path = out.with_name(f"{out.stem}-incomplete.json")
            trinoc.save(result, path, provenance=provenance, overwrite=True)
            outcome = "is unchanged" if out.exists() else "was not written"
            sentence = (
                f"{path} contains the calibrated cameras ({', '.join(result.rig.names)}); {out} "
                f"{outcome}."
            )
        sentences.append(sentence)
    return CalibrationError(" ".join(sentences), error.failures, result)
