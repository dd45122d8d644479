"""`trinoc calibrate-rig`: many shots of a board by several cameras to a rig.json with lenses."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import trinoc
from trinoc.cli.command import LOGGER, Bar, Job, Outcome, UsageError, pick
from trinoc.cli.lens_options import BOARD_SIGMA, print_systematics, read_lenses
from trinoc.cli.options import Settings
from trinoc.cli.settings import read_settings
from trinoc.cli.views import files_of_views

if TYPE_CHECKING:
    from trinoc.calib.advice.next_shot import NextShot
    from trinoc.calib.result.camera_pairs import CameraPair
    from trinoc.calib.targets.abstract_target import AbstractTarget

LensModel = Literal["default", "brown_conrady", "rational", "thin_prism", "kannala_brandt", "auto",
                    "splined", "splined_brown_conrady", "splined_rational",
                    "splined_kannala_brandt"]  # fmt: skip


def calibrate_rig(
    shots: tuple[str, ...],
    /,
    *,
    board: tuple[Path, ...],
    lens_model: Literal[LensModel, "none"] = "default",
    distortion: int | None = None,
    method: Literal["points", "pixels"] = "points",
    same_lens: bool = False,
    lens: tuple[str, ...] = (),
    world: str | None = None,
    sigma: Settings = (),
    report: Path | None = None,
    out: Path = Path("rig.json"),
    job: Job,
) -> Outcome:
    """Calibrate lenses and poses of several cameras from many shots of a moving board.

    Parameters
    ----------
    shots : NAME=FOLDER
        Folder of images of each camera, or a pattern in quotes, such as left=left/
        right='right_*.png'. Images with the same file name belong to the same shot.
    board
        Layout of the board (JSON), as `trinoc pattern` writes it. Give it several times for boards
        that are fixed to each other; their relative poses are estimated.
    lens_model
        Lens model. Default: brown_conrady; rational or kannala_brandt if brown_conrady would fold
        the image. kannala_brandt is for fisheye lenses. auto: the model that fits the shots best.
        splined: that model with a correction by B-splines.
    distortion : N (default: all that the shots determine)
        Number of distortion coefficients.
    method
        points: fit the corners or circles that the detector found. pixels: fit also the grey levels
        near the edges of a sheet of circles or of a chessboard.
    same_lens
        All cameras share one lens, for example if one camera took all images.
    lens : FILE (default: lenses are estimated)
        Calibrated lenses: camera.json or rig.json for all cameras, or NAME=camera.json for each.
        They are fixed, or estimated with the covariance in the file as a prior.
    world : NAME (default: a shot)
        World frame: the board in this shot, or this camera.
    sigma
        Standard deviations of what is not exact; 0 means exact. print_scale=0.002 (of the board's
        size, or X,Y), flatness_mm=0.3 (of the board's surface).
    report
        Write an HTML report to this file, too: verdict, cameras, residuals, uncertainty over the
        field, and matches.
    out
        File of the calibrated rig.
    """
    systematics = print_systematics(read_settings("--sigma", sigma, BOARD_SIGMA))
    for shot in shots:
        if "=" not in shot:
            raise UsageError(f'"{shot}" names no camera: write NAME=FOLDER, such as left=left/.')
    folders = files_of_views(shots)
    if not folders:
        raise UsageError("No pictures are given: write NAME=FOLDER for each camera.")
    choices: dict[str, Any] = {
        "lens_model": lens_model,
        "distortion": distortion,
        "same_lens": same_lens,
        "method": method,
        "world": world,
    }
    return calibrate_shots(folders, board, lens, systematics, choices, report, out, job)[1]


def calibrate_shots(
    folders: dict[str, Path],
    board: Sequence[Path],
    lens: tuple[str, ...],
    systematics: dict[str, Any],
    choices: dict[str, Any],
    report: Path | None,
    out: Path,
    job: Job,
) -> "tuple[trinoc.calib.CalibrationResult, Outcome]":
    """Calibrate cameras from folders of pictures, and write the rig. Return the result and the
    outcome.

    folders : folder of each camera. board : layout files. lens : values of --lens.
    systematics : fields of `Systematics` that differ from the default.
    choices : further arguments of `trinoc.calibrate_rig`.
    report, out : files to write.
    """
    job.expect(trinoc.Rig, out, report)
    target = load_boards(board)
    pictures = trinoc.io.load_shots(folders)
    lenses, stated = read_lenses(lens, pictures)
    priors = trinoc.Systematics.typical({})._replace(lens_covariance=stated, **systematics)
    LOGGER.info(
        "looking for the board; pictures: %d",
        sum(len(shots_of_camera) for shots_of_camera in pictures.values()),
    )
    with Bar("looking", quiet=job.quiet) as bar:
        result = trinoc.calibrate_rig(
            pictures,
            target,
            lens=lenses,
            systematics=priors,
            progress=bar.show,
            **choices,
        )
    provenance = job.provenance(board_files(board))
    trinoc.save(result, out, provenance=provenance, overwrite=True)
    advice = trinoc.next_shot(result)
    sentence = "" if advice is None else advice.sentence
    job.write_report(
        report,
        provenance,
        result=result,
        shot_pictures=pictures,
        title="Rig from many shots",
        advice=sentence,
    )
    text = "\n".join(filter(None, [result.summary(), sentence]))
    record = {**rig_record(result), "next_shot": shot_record(advice)}
    refusal = None
    if result.overall_status is trinoc.calib.Status.SUSPECT:
        refusal = (
            f"The rig is SUSPECT, which is stated in {out}: {result.notes[0].removesuffix('.')}."
        )
    return result, Outcome(text, record, refusal, written=(out, report))


def load_boards(files: Sequence[Path]) -> "AbstractTarget":
    """Load the board of one layout file, or a set of the boards of several files.

    The boards of a set are named by their own names if these differ, else by the names of the
    files, else by numbers.
    """
    if not files:
        raise UsageError("No board is given: add --board FILE, as `trinoc pattern` writes it.")
    boards = [trinoc.io.load_target(file) for file in files]
    if len(boards) == 1:
        return boards[0]
    for names in ([board.name for board in boards], [file.stem for file in files]):
        if len(set(names)) == len(names):
            return trinoc.calib.BoardSet(dict(zip(names, boards, strict=True)))
    return trinoc.calib.BoardSet(
        {f"board {number}": board for number, board in enumerate(boards, 1)}
    )


def board_files(files: Sequence[Path]) -> dict[str, Path]:
    """Layout files by name, for the provenance."""
    if len(files) == 1:
        return {"board": files[0]}
    return {f"board {number}": file for number, file in enumerate(files, 1)}


def shot_record(advice: "NextShot | None") -> dict[str, Any] | None:
    """Recommended next shot as a JSON object; None without one."""
    names = ("sentence", "cameras", "world_from_board", "error_now_px", "error_then_px")
    return None if advice is None else pick(advice, *names, "sigma_then")


def _pair_record(pair: "CameraPair") -> dict[str, Any]:
    """Baseline and relative rotation of two cameras as a JSON object."""
    turns = zip("xyz", pair.turn_deg, pair.turn_sigma_deg, strict=True)
    return {
        "cameras": [pair.first, pair.second],
        "baseline_mm": {
            "value": pair.baseline_mm,
            "sigma": pair.baseline_sigma_mm,
            "sigma_board_size": pair.size_sigma_mm,
            "sigma_rest": pair.rest_sigma_mm,
        },
        "angle_deg": {"value": pair.angle_deg, "sigma": pair.angle_sigma_deg},
        "turn_deg": {
            axis: {"value": float(value), "sigma": float(sigma)} for axis, value, sigma in turns
        },
        **pick(pair, "second_from_first"),
    }


def rig_record(result: "trinoc.calib.CalibrationResult") -> dict[str, Any]:
    """Summary of a rig from many shots as a JSON object."""
    from trinoc.calib.targets.board_set import board_names

    halves, held_out, pixel = result.halves, result.cross_validation, result.pixel_sigma
    poses = zip(board_names(result.board), result.reference_from_board, strict=True)
    return {
        "parameters": {
            name: {"value": float(value), "sigma": result.sigma(name)}
            for name, value in zip(result.parameters, result.values, strict=True)
        },
        "cameras": {
            name: {
                "pictures": len(
                    {view.shot for view in result.views if view.camera == k and view.used.any()}
                ),
                "rms_px": result.rms_px(name),
                "sigma_factor": result.fits[name].sigma_factor,
            }
            for k, name in enumerate(result.cameras)
        },
        "pairs": [_pair_record(pair) for pair in result.pairs],
        "pixel_sigma": pixel
        and {
            **pick(pixel, "median_px", "worst_px"),
            "board_size_px": pixel.size_px,
        },
        **pick(result, "shots", "world", "failures", "refused", "notes"),
        "boards": {name: {"reference_from_board": pose.tolist()} for name, pose in poses},
        "halves": halves
        and {
            **pick(halves, "ratio", "worst", "worst_ratio"),
            # How far apart both halves image points, root mean square over the field.
            "over_field": {
                field.camera: {
                    **pick(field, "distance_mm", "rms_px"),
                    "over_sigma": field.rms_over_sigma.tolist(),
                }
                for field in halves.over_field
            },
        },
        "cross_validation": held_out and pick(held_out, "shots", "own_px", "across_px"),
        "sigmas_include": ["noise", *result.systematics],
    }
