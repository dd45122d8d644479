"""`trinoc calibrate-rig`: many shots of a board by several cameras to a rig.json with lenses."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import LOGGER, Bar, Command, Out, Outcome, ReportOption, UsageError
from trinoc.cli.lens_options import BOARD_SIGMA, LensFiles, print_systematics, read_lenses
from trinoc.cli.settings import Settings, read_settings
from trinoc.cli.views import files_of_views

if TYPE_CHECKING:
    from trinoc.calib.advice.next_shot import NextShot
    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.calib.result.camera_pairs import CameraPair
    from trinoc.calib.result.halves import FieldDifference
    from trinoc.calib.targets.abstract_target import AbstractTarget


@dataclasses.dataclass(frozen=True, kw_only=True)
class CalibrateRigCommand(ReportOption, Command):
    """Calibrate lenses and cameras together from many shots of a board that is moved about."""

    shots: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME=FOLDER", help_behavior_hint="(required)"),
    ]
    """The folder of each camera's pictures, or a pattern in quotes, such as left=left/
    right='right_*.png'. Pictures of equal names are of one moment."""

    board: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]],
        tyro.conf.arg(aliases=("--pattern",), metavar="FILE", help_behavior_hint="(required)"),
    ]
    """Layout of the board (JSON), as `trinoc pattern` writes it: sheet or board. Given several
    times for boards that are fixed to each other; how they are is found."""

    lens_model: Literal[
        "default",
        "brown_conrady",
        "rational",
        "thin_prism",
        "kannala_brandt",
        "none",
        "auto",
        "splined",
        "splined_brown_conrady",
        "splined_rational",
        "splined_kannala_brandt",
    ] = "default"
    """Model of the lenses. The default is brown_conrady, or rational or kannala_brandt where that
    would fold a picture. kannala_brandt is for fisheyes; auto takes the one that the shots call
    for, splined the best one corrected by B-splines."""

    distortion: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: all determined)")
    ] = None
    """Number of coefficients of that model."""

    method: Literal["points", "pixels"] = "points"
    """Fit the places that the detector found, or go on to the grey levels near every edge of a
    sheet of circles or a chessboard."""

    same_lens: bool = False
    """All cameras have one lens, such as pictures of one camera moved about."""

    lens: Annotated[LensFiles, tyro.conf.arg(help_behavior_hint="(default: lenses are found)")] = ()
    """Known lenses, held or fitted under their file's covariance: camera.json or rig.json of all
    cameras, or NAME=camera.json."""

    world: Annotated[
        str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: a shot)")
    ] = None
    """The shot whose board, or the camera whose frame, is the world."""

    sigma: Settings = ()
    """Standard deviations of what is not exact, 0 for what is: print_scale=0.002 (of the board's
    scale, or X,Y), flatness_mm=0.3 (of the board's warp)."""

    out: Out = Path("rig.json")
    """Where the rig goes."""

    def run(self, command_line: str) -> Outcome:
        """Calibrate and write the rig."""
        return self.calibrate(command_line)[1]

    def calibrate(self, command_line: str) -> "tuple[CalibrationResult, Outcome]":
        """The same, with what was found."""
        sigma = read_settings("--sigma", self.sigma, BOARD_SIGMA)
        for shot in self.shots:
            if "=" not in shot:
                raise UsageError(
                    f'"{shot}" names no camera: write NAME=FOLDER, such as left=left/.'
                )
        places = files_of_views(self.shots)
        if not places:
            raise UsageError("No pictures are given: write NAME=FOLDER for each camera.")

        from trinoc.calib.advice.next_shot import next_shot
        from trinoc.calib.result.calibration import Status
        from trinoc.calib.rig_calibration import calibrate_rig
        from trinoc.calib.uncertainty.systematics import Systematics
        from trinoc.cli.command import provenance
        from trinoc.geometry.rig import Rig
        from trinoc.io.atomic import expect_place
        from trinoc.io.images import load_shots
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out, self.report)
        expect_replaceable(self.out, Rig, force=self.force)
        target = load_boards(self.board)
        pictures = load_shots(places)
        known, stated = read_lenses(self.lens, pictures)
        beforehand = Systematics.typical({})._replace(
            lens_covariance=stated, **print_systematics(sigma)
        )
        LOGGER.info(
            "looking for the board; pictures: %d", sum(len(own) for own in pictures.values())
        )
        with Bar("looking", quiet=self.quiet) as bar:
            result = calibrate_rig(
                pictures,
                target,
                lens=known,
                lens_model=self.lens_model,
                distortion=self.distortion,
                same_lens=self.same_lens,
                method=self.method,
                world=self.world,
                systematics=beforehand,
                progress=bar.show,
            )
        made_by = provenance(command_line, board_files(self.board))
        save(result, self.out, provenance=made_by, overwrite=True)
        advice = next_shot(result)
        said = "" if advice is None else advice.sentence
        self.write_report(
            made_by,
            result=result,
            shot_pictures=pictures,
            title="Rig from many shots",
            advice=said,
        )
        text = "\n".join(filter(None, [result.summary(), said]))
        record = {**rig_record(result), "next_shot": shot_record(advice)}
        refusal = None
        if result.overall_status is Status.SUSPECT:
            why = result.notes[0].removesuffix(".")
            refusal = f"The rig is SUSPECT, and {self.out} says so: {why}."
        return result, Outcome(text, record, refusal, written=(self.out, self.report))


def load_boards(files: tuple[Path, ...]) -> "AbstractTarget":
    """The board of a layout, or the set of the boards of several; see `one_target`."""
    from trinoc.io.board_json import load_target

    return one_target([(file.stem, load_target(file)) for file in files])


def board_files(files: tuple[Path, ...]) -> dict[str, Path]:
    """The layouts, for the provenance of files."""
    if len(files) == 1:
        return {"board": files[0]}
    return {f"board {number}": file for number, file in enumerate(files, 1)}


def one_target(given: "list[tuple[str, AbstractTarget]]") -> "AbstractTarget":
    """The board, or the set of boards that are fixed to each other, each with the name of its file.

    Their own names count where they differ, else those of the files, else their numbers.
    """
    from trinoc.calib.targets.board_set import BoardSet

    if len(given) == 1:
        return given[0][1]
    boards = [board for _, board in given]
    for names in ([board.name for board in boards], [stem for stem, _ in given]):
        if len(set(names)) == len(names):
            return BoardSet(dict(zip(names, boards, strict=True)))
    return BoardSet({f"board {number}": board for number, board in enumerate(boards, 1)})


def shot_record(advice: "NextShot | None") -> dict[str, Any] | None:
    """The shot to take next, as JSON can hold it."""
    if advice is None:
        return None
    return {
        "sentence": advice.sentence,
        "cameras": list(advice.cameras),
        "world_from_board": advice.world_from_board.tolist(),
        "error_now_px": advice.error_now_px,
        "error_then_px": advice.error_then_px,
        "sigma_then": dict(advice.sigma_then),
    }


def field_record(field: "FieldDifference") -> dict[str, Any]:
    """How far apart two halves image the same points, at the boards and farther, root mean square
    over the field."""
    return {
        "distance_mm": field.distance_mm.tolist(),
        "rms_px": field.rms_px.tolist(),
        "over_sigma": field.rms_over_sigma.tolist(),
    }


def pair_record(pair: "CameraPair") -> dict[str, Any]:
    """Baseline and relative rotation of two cameras, as JSON can hold it."""
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
            axis: {"value": float(value), "sigma": float(sigma)}
            for axis, value, sigma in zip("xyz", pair.turn_deg, pair.turn_sigma_deg, strict=True)
        },
        "second_from_first": pair.second_from_first.tolist(),
    }


def rig_record(result: "CalibrationResult") -> dict[str, Any]:
    """What programs want to know of a rig from many shots, as JSON can hold it."""
    from trinoc.calib.targets.board_set import board_names

    halves, held_out, known = result.halves, result.cross_validation, result.pixel_sigma
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
        "pairs": [pair_record(pair) for pair in result.pairs],
        "pixel_sigma": None
        if known is None
        else {
            "median_px": known.median_px,
            "worst_px": known.worst_px,
            "board_size_px": known.size_px,
        },
        "shots": list(result.shots),
        "world": result.world,
        "boards": {
            name: {"reference_from_board": pose.tolist()}
            for name, pose in zip(
                board_names(result.board), result.reference_from_board, strict=True
            )
        },
        "halves": None
        if halves is None
        else {
            "ratio": halves.ratio,
            "worst": halves.worst,
            "worst_ratio": halves.worst_ratio,
            "over_field": {field.camera: field_record(field) for field in halves.over_field},
        },
        "cross_validation": None
        if held_out is None
        else {
            "shots": held_out.shots,
            "own_px": dict(held_out.own_px),
            "across_px": dict(held_out.across_px),
        },
        "sigmas_include": ["noise", *result.systematics],
        "failures": dict(result.failures),
        "refused": list(result.refused),
        "notes": list(result.notes),
    }
