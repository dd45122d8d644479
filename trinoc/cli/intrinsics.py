"""`trinoc intrinsics`: a lens from pictures of a board."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import trinoc
from trinoc.cli.calibrate_rig import LensModel, board_files, load_boards
from trinoc.cli.command import LOGGER, Job, Outcome, UsageError
from trinoc.cli.lens_options import expect_pixel_pitch

if TYPE_CHECKING:
    from trinoc.calib.advice.next_shot import NextShot

# Not None: an option that may be a pair or nothing would take pictures that follow it.
NO_PITCH = (0.0, 0.0)


def intrinsics(
    images: tuple[Path, ...],
    /,
    *,
    board: tuple[Path, ...],
    lens_model: LensModel = "default",
    distortion: int | None = None,
    pixel_pitch_mm: tuple[float, float] = NO_PITCH,
    hold: tuple[Literal["principal-point", "aspect"], ...] = (),
    method: Literal["points", "pixels"] = "points",
    out: Path = Path("camera.json"),
    job: Job,
) -> Outcome:
    """Calibrate the lens of one camera from several images of a board.

    Parameters
    ----------
    images : IMG
        Images from one camera at fixed zoom and focus, with the board in a different pose in each.
    board
        Layout of the board (JSON), as `trinoc pattern` writes it. Give it several times for boards
        that are fixed to each other.
    lens_model
        Lens model. Default: brown_conrady; rational or kannala_brandt if brown_conrady would fold
        the image. auto: the model that fits the images best. splined: that model with a correction
        by B-splines, for a lens that no polynomial describes.
    distortion : N (default: all that the images determine)
        Number of distortion coefficients; for brown_conrady, of k1, k2, p1, p2, k3.
    pixel_pitch_mm : WIDTH HEIGHT (optional)
        Width and height of a pixel in mm. Give both, even if they are equal.
    hold : principal-point|aspect... (default: none)
        Parameters that are fixed. principal-point: at the image centre. aspect: ratio of the two
        focal lengths, from the pixel size.
    method
        points: fit the corners or circles that the detector found. pixels: fit also the grey levels
        near the edges of a sheet of circles or of a chessboard.
    out
        File of the calibrated lens.
    """
    if not images:
        raise UsageError("No picture is given: give several pictures of the board.")
    pitch_mm = None if pixel_pitch_mm == NO_PITCH else pixel_pitch_mm
    expect_pixel_pitch(pitch_mm, "--pixel-pitch-mm is")

    job.expect(trinoc.Intrinsics, out)
    target = load_boards(board)
    pictures = [trinoc.io.read_image(path) for path in job.each(images, "reading")]
    LOGGER.info("calibrating the lens of %d pictures", len(pictures))
    result = trinoc.calibrate_intrinsics(
        pictures,
        target,
        distortion=distortion,
        lens_model=lens_model,
        principal_point="centre" if "principal-point" in hold else "free",
        pixel_pitch_mm=pitch_mm,
        aspect="pitch" if "aspect" in hold else "free",
        method=method,
    )
    inputs = {f"picture {number}": path for number, path in enumerate(images, 1)}
    provenance = job.provenance({**inputs, **board_files(board)})
    trinoc.save(result, out, provenance=provenance, overwrite=True)
    advice = trinoc.next_shot(result)
    text = "\n".join(filter(None, [result.summary(), advice and advice.sentence]))
    refusal = None
    if result.overall_status is trinoc.calib.Status.SUSPECT:
        refusal = f"The lens in {out} is SUSPECT: {result.notes[0]}"
    return Outcome(text, _intrinsics_record(result, advice), refusal, written=(out,))


def _intrinsics_record(
    result: "trinoc.calib.CalibrationResult", advice: "NextShot | None"
) -> dict[str, Any]:
    """Summary of a lens calibration as a JSON object. advice : recommended next shot."""
    import numpy as np

    fit = result.fits[result.cameras[0]]
    return {
        "parameters": {
            name: {
                "value": result.value(name),
                "sigma": result.sigma(name),
                "free": result.sigma(name) != 0.0,
            }
            for name in result.lens_parameters
        },
        "pictures": len({view.shot for view in result.views if view.used.any()}),
        "failures": {
            where.rpartition("picture ")[2]: why for where, why in result.failures.items()
        },
        "circles": sum(int(view.used.sum()) for view in result.views),
        "rms_px": fit.rms_px,
        "reduced_chi_square": fit.sigma_factor**2 * result.reduced_chi_square,
        "largest_sigma_px": float(np.nanmax(result.field_sigma_px)),
        "sigmas_include": ["noise", *result.systematics],
        "notes": [*result.notes, *result.refused],
        "next_picture": None if advice is None else advice.sentence,
    }
