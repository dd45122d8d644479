"""`trinoc intrinsics`, `undistort`: a lens from pictures of a board; pictures without a lens."""

import dataclasses
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import LOGGER, Command, Out, Outcome, UsageError, each
from trinoc.cli.lens_options import expect_pixel_pitch
from trinoc.cli.views import expect_names, files_of_rig, make_folder, read_rig, warn_of_folds
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.calib.advice.next_shot import NextShot
    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.geometry.intrinsics import Intrinsics
    from trinoc.image.ideal_pictures import PictureMaps


# Not None: an option that may be a pair or nothing would take pictures that follow it.
NO_PITCH = (0.0, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class IntrinsicsCommand(Command):
    """Find focal length, principal point and distortion from several pictures of a board."""

    images: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="IMG", help_behavior_hint="(required)"),
    ]
    """Pictures by one camera at one zoom and focus, the board held differently in each."""

    board: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]],
        tyro.conf.arg(aliases=("--pattern",), metavar="FILE", help_behavior_hint="(required)"),
    ]
    """Layout of the board (JSON), as `trinoc pattern` writes it: sheet or board. Given several
    times for boards that are fixed to each other."""

    lens_model: Literal[
        "default",
        "brown_conrady",
        "rational",
        "thin_prism",
        "kannala_brandt",
        "auto",
        "splined",
        "splined_brown_conrady",
        "splined_rational",
        "splined_kannala_brandt",
    ] = "default"
    """Model of the lens. The default is brown_conrady, or rational or kannala_brandt where that
    would fold the picture. auto takes the one that the pictures call for, splined the best one
    corrected by B-splines, for a lens that no polynomial describes."""

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
    """Fit the places that the detector found, or go on to the grey levels near every edge of a
    sheet of circles or a chessboard."""

    out: Out = Path("camera.json")
    """Where the lens goes."""

    def run(self, command_line: str) -> Outcome:
        """Calibrate the lens and write it."""
        if not self.images:
            raise UsageError("No picture is given: give several pictures of the board.")
        pitch_mm = None if self.pixel_pitch_mm == NO_PITCH else self.pixel_pitch_mm
        expect_pixel_pitch(pitch_mm, "--pixel-pitch-mm is")

        from trinoc.calib.advice.next_shot import next_shot
        from trinoc.calib.lens_calibration import calibrate_intrinsics
        from trinoc.calib.problem.status import Status
        from trinoc.cli.calibrate_rig import board_files, load_boards
        from trinoc.cli.command import provenance
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.io.atomic import expect_place
        from trinoc.io.images import read_image
        from trinoc.io.saving import expect_replaceable, save

        expect_place(self.out)
        expect_replaceable(self.out, Intrinsics, force=self.force)
        pattern = load_boards(self.board)
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
            provenance=provenance(command_line, {**inputs, **board_files(self.board)}),
            overwrite=True,
        )
        advice = next_shot(result)
        text = "\n".join(filter(None, [result.summary(), advice.sentence if advice else ""]))
        refusal = None
        if result.overall_status is Status.SUSPECT:
            refusal = f"The lens in {self.out} is SUSPECT: {result.notes[0]}"
        return Outcome(text, intrinsics_record(result, advice), refusal, written=(self.out,))


def intrinsics_record(result: "CalibrationResult", advice: "NextShot | None") -> dict[str, Any]:
    """Values of a lens that programs want, as JSON can hold them."""
    import numpy as np

    fit, names = result.fits[result.cameras[0]], result.lens_parameters
    return {
        "parameters": {
            name: {
                "value": result.value(name),
                "sigma": result.sigma(name),
                "free": result.sigma(name) != 0.0,
            }
            for name in names
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class UndistortCommand(Command):
    """Make pictures as cameras without distortion take them, also turned until rows correspond."""

    images: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME=FILE", help_behavior_hint="(required)"),
    ]
    """For each camera its picture; or pictures of one lens."""

    rig: Annotated[Path, tyro.conf.arg(aliases=("--lens", "--intrinsics"), metavar="FILE")]
    """The cameras, or the camera.json of one lens."""

    rectify: bool = False
    """Also turn two cameras until a point has the same row in both pictures."""

    alpha: float = 0.0
    """How much of the field is kept, from 0, no black pixels, to 1, all of it."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="FOLDER")] = Path("undistorted")
    """The folder of the new pictures (PNG), their rig.json or camera.json, and maps for
    cv2.remap."""

    def run(self, command_line: str) -> Outcome:
        """Read and check everything, then write."""
        if not self.images:
            raise UsageError("No picture is given: write NAME=FILE for each camera.")
        if not 0 <= self.alpha <= 1:
            raise UsageError(f"--alpha is {self.alpha:g}: give a number from 0 to 1.")

        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.geometry.rig import Rig
        from trinoc.io.saving import load

        cameras = load(self.rig)
        if isinstance(cameras, Rig):
            return self._of_rig(command_line)
        if not isinstance(cameras, Intrinsics):
            raise UsageError(f"{self.rig} holds neither a rig nor a lens: give one of them.")
        if self.rectify:
            raise UsageError(f"--rectify is of a rig, but {self.rig} holds one lens: leave it out.")
        warn_of_folds(cameras, self.rig)
        return self._of_lens(cameras, command_line)

    def _of_rig(self, command_line: str) -> Outcome:
        from trinoc.cli.command import provenance
        from trinoc.geometry.rig import PARAMETER_NAMES, Rig
        from trinoc.image.ideal_pictures import rectify, undistort
        from trinoc.io.atomic import as_file_name
        from trinoc.io.images import expect_size, read_views, write_picture
        from trinoc.io.rig_json import load_rig_status, save_rig, status_of_names
        from trinoc.io.saving import save

        rig = read_rig(self.rig)
        files = files_of_rig(self.images, rig.names)
        expect_names(files, rig, self.rig)
        pictures = dict(zip(files, self._new_pictures(files.values(), files), strict=True))
        maps = {view: self.out / f"{as_file_name(view)}-maps.npz" for view in files}
        place = self.out / "rig.json"
        self._expect_places(files.values(), pictures.values(), maps.values(), {place: Rig})
        images = read_views(files)
        for view, image in images.items():
            expect_size(view, image, rig)
        chosen = Rig(
            {view: rig[view] for view in files},
            parameters=rig.parameters,
            covariance=rig.covariance,
        )
        ideal = (rectify if self.rectify else undistort)(chosen, alpha=self.alpha)
        notes, has_sigmas = [*ideal.notes], bool(ideal.rig.parameters)
        if rig.parameters and not has_sigmas:
            known = {own.rpartition(".") for own in rig.parameters}
            is_open = any(own not in PARAMETER_NAMES for view, _, own in known if view in files)
            why = (
                f"errors of the lenses, which {self.rig} has, bend the rays of a picture as no "
                "ideal camera does"
                if is_open
                else "an axis does not meet the sheet"
            )
            notes.append(f"The new rig has no sigmas: {why}.")
        make_folder(self.out)
        for view in each(tuple(files), "undistorting", quiet=self.quiet):
            save(ideal.maps[view], maps[view], overwrite=True)
            write_picture(pictures[view], ideal.maps[view].resample(images[view]))
        origin = provenance(command_line, {"rig": self.rig, **files})
        status = status_of_names(load_rig_status(self.rig), ideal.rig.names, sigmas=has_sigmas)
        save_rig(ideal.rig, place, provenance={**origin, "notes": notes}, status=status)
        lenses = {view: camera.intrinsics for view, camera in ideal.rig.items()}
        depths = []
        if (disparity := ideal.disparity) is not None:
            depths.append(
                f"Depth in mm is {disparity.product_px_mm:.6g} / (u_{disparity.first} - "
                f"u_{disparity.second} - ({disparity.offset_px:.6g})), in pixels of the new "
                "pictures.",
            )
        record = {
            **_record(lenses, pictures, maps),
            "disparity": None if disparity is None else disparity._asdict(),
            "has_sigmas": has_sigmas,
            "notes": notes,
        }
        text = "\n".join([_table(lenses, ideal.maps), *depths, *notes])
        return Outcome(text, record, written=(*pictures.values(), *maps.values(), place))

    def _of_lens(self, lens: "Intrinsics", command_line: str) -> Outcome:
        from trinoc.cli.command import provenance
        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.image.ideal_pictures import undistort
        from trinoc.io.images import read_image, read_size_px, write_picture
        from trinoc.io.saving import save

        files = [Path(file) for file in self.images]
        pictures = dict(zip(self._new_pictures(files), files, strict=True))
        maps, place = self.out / "maps.npz", self.out / "camera.json"
        self._expect_places(files, pictures, [maps], {place: Intrinsics})
        for file in files:
            size = read_size_px(file)
            if size != lens.image_size_px:
                sizes = [f"{width} x {height} px" for width, height in (size, lens.image_size_px)]
                raise InputError(
                    f"{file} is {sizes[0]}, but {self.rig} is of pictures of {sizes[1]}: give "
                    "pictures of that size."
                )
        ideal = undistort(lens, alpha=self.alpha)
        make_folder(self.out)
        save(
            ideal.lens,
            place,
            provenance=provenance(command_line, {"lens": self.rig}),
            overwrite=True,
        )
        save(ideal.maps, maps, overwrite=True)
        for new, file in each(pictures.items(), "undistorting", quiet=self.quiet):
            write_picture(new, ideal.maps.resample(read_image(file)))
        named = {"lens": ideal.lens}
        record = _record(named, {}, {"lens": maps})
        return Outcome(
            _table(named, {"lens": ideal.maps}), record, written=(*pictures, maps, place)
        )

    def _new_pictures(self, files: Collection[Path], views: Iterable[str] = ()) -> list[Path]:
        """Where the new pictures go: their names, behind those of the views where they are equal.

        Raises UsageError where two would have one name.
        """
        from trinoc.io.atomic import as_file_name

        names = [file.stem for file in files]
        if len(set(names)) < len(names):
            names = [f"{as_file_name(v)}_{name}" for v, name in zip(views, names)] or names
        new = [self.out / f"{name}.png" for name in names]
        files = list(files)
        for k, place in enumerate(new):
            if place in new[:k]:
                raise UsageError(
                    f"{files[new.index(place)]} and {files[k]} would both become {place}: give "
                    "pictures with names of their own."
                )
        return new

    def _expect_places(
        self,
        read: Iterable[Path],
        pictures: Iterable[Path],
        maps: Iterable[Path],
        cameras: Mapping[Path, type],
    ) -> None:
        """Raise UsageError or InputError where something would be lost."""
        from trinoc.image.ideal_pictures import PictureMaps
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable

        if self.out.exists() and not self.out.is_dir():
            raise UsageError(f"--out is {self.out}, which is no folder: give one.")
        kinds = {**dict.fromkeys(maps, PictureMaps), **cameras}
        taken = {file.resolve() for file in (self.rig, *read)}
        for place in (*pictures, *kinds):
            if place.resolve() in taken:
                raise UsageError(f"{place} is read, and would be lost: give another --out.")
        # A folder with maps is one that this command wrote before.
        is_ours = all(place.exists() for place in kinds)
        for place, kind in kinds.items() if self.out.exists() else ():
            expect_place(place)
            expect_replaceable(place, kind, force=self.force)
        for place in pictures:
            if place.exists() and not (is_ours or self.force):
                raise InputError(
                    f"{place} is there and would be lost: give another --out, or --force."
                )


def _table(lenses: "Mapping[str, Intrinsics]", maps: "Mapping[str, PictureMaps]") -> str:
    from trinoc.report.report_table import text_table

    head = ("camera", "focal length (px)", "principal point (px)", "skew (px)", "valid pixels")
    rows = [
        (
            name,
            *(f"{u:.2f} {v:.2f}" for u, v in (lens.focal_length_px, lens.principal_point_px)),
            f"{float(lens.skew_px):.2f}",
            f"{maps[name].valid.mean():.1%}",
        )
        for name, lens in lenses.items()
    ]
    return text_table(head, rows)


def _record(
    lenses: "Mapping[str, Intrinsics]", pictures: Mapping[str, Path], maps: Mapping[str, Path]
) -> dict[str, Any]:
    """What programs want to know of the new cameras, as JSON can hold it."""
    cameras = {
        name: {
            "image_size_px": list(lens.image_size_px),
            "matrix": lens.matrix.tolist(),
            "maps": str(maps[name]),
            **({"picture": str(pictures[name])} if name in pictures else {}),
        }
        for name, lens in lenses.items()
    }
    return {"cameras": cameras}
