"""`trinoc undistort`: pictures as cameras without distortion take them."""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import trinoc
from trinoc.cli.command import Job, Outcome, UsageError
from trinoc.cli.views import expect_names, files_of_rig, make_folder, read_rig, warn_of_folds
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.image.ideal_pictures import PictureMaps


def undistort(
    images: tuple[str, ...],
    /,
    *,
    rig: Path,
    rectify: bool = False,
    alpha: float = 0.0,
    out: Path = Path("undistorted"),
    job: Job,
) -> Outcome:
    """Remove lens distortion from images, and rectify image pairs.

    Parameters
    ----------
    images : NAME=FILE
        The image of each camera, or several images of one lens.
    rig
        The calibrated cameras, or the camera.json of one lens.
    rectify
        Rectify the images of two cameras: a scene point has the same row in both.
    alpha
        Part of the field of view that is kept, from 0 (no black pixels) to 1 (all).
    out : FOLDER
        Folder for the new images (PNG), their rig.json or camera.json, and maps for cv2.remap.
    """
    if not images:
        raise UsageError("No picture is given: write NAME=FILE for each camera.")
    if not 0 <= alpha <= 1:
        raise UsageError(f"--alpha is {alpha:g}: give a number from 0 to 1.")

    cameras = trinoc.load(rig)
    if isinstance(cameras, trinoc.Rig):
        return _undistort_rig(images, rig, rectify, alpha, out, job)
    if not isinstance(cameras, trinoc.Intrinsics):
        raise UsageError(f"{rig} holds neither a rig nor a lens: give one of them.")
    if rectify:
        raise UsageError(f"--rectify needs a rig, but {rig} contains one lens: omit --rectify.")
    warn_of_folds(cameras, rig)
    return _undistort_lens(cameras, [Path(image) for image in images], rig, alpha, out, job)


def _undistort_rig(
    images: tuple[str, ...], rig_file: Path, is_rectified: bool, alpha: float, out: Path, job: Job
) -> Outcome:
    from trinoc.geometry.rig import PARAMETER_NAMES
    from trinoc.io.atomic import as_file_name
    from trinoc.io.images import expect_size
    from trinoc.io.rig_json import load_rig_status, save_rig, status_of_names

    rig = read_rig(rig_file)
    files = files_of_rig(images, rig.names)
    expect_names(files, rig, rig_file)
    new = dict(zip(files, _new_pictures(out, files.values(), files), strict=True))
    maps = {view: out / f"{as_file_name(view)}-maps.npz" for view in files}
    place = out / "rig.json"
    _expect_places(
        out, (rig_file, *files.values()), new.values(), maps.values(), {place: trinoc.Rig}, job
    )
    pictures = trinoc.io.read_views(files)
    for view, picture in pictures.items():
        expect_size(view, picture, rig)
    rig_of_views = trinoc.Rig(
        {view: rig[view] for view in files}, parameters=rig.parameters, covariance=rig.covariance
    )
    ideal = (trinoc.rectify if is_rectified else trinoc.undistort)(rig_of_views, alpha=alpha)
    notes, has_sigmas = [*ideal.notes], bool(ideal.rig.parameters)
    if rig.parameters and not has_sigmas:
        parameters = [name.rpartition(".") for name in rig.parameters]
        is_open = any(
            parameter not in PARAMETER_NAMES for view, _, parameter in parameters if view in files
        )
        reason = (
            f"{rig_file} has errors of the lenses, which the new cameras without distortion cannot "
            "contain"
            if is_open
            else "an optical axis does not meet the sheet"
        )
        notes.append(f"The new rig has no sigmas: {reason}.")
    make_folder(out)
    for view in job.each(tuple(files), "undistorting"):
        trinoc.save(ideal.maps[view], maps[view], overwrite=True)
        trinoc.io.write_picture(new[view], ideal.maps[view].resample(pictures[view]))
    provenance = {**job.provenance({"rig": rig_file, **files}), "notes": notes}
    status = status_of_names(load_rig_status(rig_file), ideal.rig.names, sigmas=has_sigmas)
    save_rig(ideal.rig, place, provenance=provenance, status=status)
    lenses = {view: camera.intrinsics for view, camera in ideal.rig.items()}
    depths = []
    if (disparity := ideal.disparity) is not None:
        depths.append(
            f"Depth in mm is {disparity.product_px_mm:.6g} / (u_{disparity.first} - "
            f"u_{disparity.second} - ({disparity.offset_px:.6g})), in pixels of the new pictures."
        )
    record = {
        **_record(lenses, new, maps),
        "disparity": None if disparity is None else disparity._asdict(),
        "has_sigmas": has_sigmas,
        "notes": notes,
    }
    text = "\n".join([_table(lenses, ideal.maps), *depths, *notes])
    return Outcome(text, record, written=(*new.values(), *maps.values(), place))


def _undistort_lens(
    lens: "trinoc.Intrinsics", files: list[Path], lens_file: Path, alpha: float, out: Path, job: Job
) -> Outcome:
    from trinoc.io.images import read_size_px

    new = dict(zip(_new_pictures(out, files), files, strict=True))
    maps, place = out / "maps.npz", out / "camera.json"
    _expect_places(out, (lens_file, *files), new, [maps], {place: trinoc.Intrinsics}, job)
    for file in files:
        size = read_size_px(file)
        if size != lens.image_size_px:
            sizes = [f"{width} x {height} px" for width, height in (size, lens.image_size_px)]
            raise InputError(
                f"{file} is {sizes[0]}, but {lens_file} is for pictures of {sizes[1]}: give "
                "pictures of that size."
            )
    ideal = trinoc.undistort(lens, alpha=alpha)
    make_folder(out)
    trinoc.save(ideal.lens, place, provenance=job.provenance({"lens": lens_file}), overwrite=True)
    trinoc.save(ideal.maps, maps, overwrite=True)
    for picture, file in job.each(new.items(), "undistorting"):
        trinoc.io.write_picture(picture, ideal.maps.resample(trinoc.io.read_image(file)))
    lenses = {"lens": ideal.lens}
    record = _record(lenses, {}, {"lens": maps})
    return Outcome(_table(lenses, {"lens": ideal.maps}), record, written=(*new, maps, place))


def _new_pictures(out: Path, files: Collection[Path], views: Iterable[str] = ()) -> list[Path]:
    """Files of the new images, named after the original files.

    The name of the view precedes names that are equal. Raises UsageError if two images would have
    one name.
    """
    from trinoc.io.atomic import as_file_name

    names = [file.stem for file in files]
    if len(set(names)) < len(names):
        names = [f"{as_file_name(view)}_{name}" for view, name in zip(views, names)] or names
    new = [out / f"{name}.png" for name in names]
    files = list(files)
    for k, path in enumerate(new):
        if path in new[:k]:
            raise UsageError(
                f"{files[new.index(path)]} and {files[k]} would both become {path}: give pictures "
                "with different names."
            )
    return new


def _expect_places(
    out: Path,
    read: Iterable[Path],
    pictures: Iterable[Path],
    maps: Iterable[Path],
    cameras: Mapping[Path, type],
    job: Job,
) -> None:
    """Raise UsageError or InputError if the command would overwrite an input or a file of another
    kind.
    """
    from trinoc.image.ideal_pictures import PictureMaps

    if out.exists() and not out.is_dir():
        raise UsageError(f"--out is {out}, which is not a folder: give a folder.")
    kinds = {**dict.fromkeys(maps, PictureMaps), **cameras}
    input_files = {file.resolve() for file in read}
    for path in (*pictures, *kinds):
        if path.resolve() in input_files:
            raise UsageError(f"{path} is an input and would be overwritten: give another --out.")
    # A folder with maps is one that this command wrote before.
    is_ours = all(path.exists() for path in kinds)
    for path, kind in kinds.items() if out.exists() else ():
        job.expect(kind, path)
    for path in pictures:
        if path.exists() and not (is_ours or job.force):
            raise InputError(
                f"{path} exists and would be overwritten: give another --out, or --force."
            )


def _table(lenses: "Mapping[str, trinoc.Intrinsics]", maps: "Mapping[str, PictureMaps]") -> str:
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
    lenses: "Mapping[str, trinoc.Intrinsics]",
    pictures: Mapping[str, Path],
    maps: Mapping[str, Path],
) -> dict[str, Any]:
    """Summary of the new cameras as a JSON object."""
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
