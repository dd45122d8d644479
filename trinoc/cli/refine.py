"""`trinoc refine`, `check`, `compare`: a rig beside matches made with it, or an earlier rig."""

import math
from pathlib import Path
from typing import Any, Literal

import trinoc
from trinoc.cli.command import LOGGER, Job, Outcome, as_json, pick
from trinoc.cli.views import read_rig, read_scene
from trinoc.errors import CalibrationError


def refine(
    images: tuple[str, ...] = (),
    /,
    *,
    rig: Path,
    matches: Path | None = None,
    pose_model: Literal["aimed", "aim-free", "rigid"] | None = None,
    free_lens: bool = False,
    moved: tuple[str, ...] = (),
    out: Path = Path("refined.json"),
    job: Job,
) -> Outcome:
    """Refine a rig by joint adjustment of its calibration and matched segments.

    Parameters
    ----------
    images : NAME=FILE (or --matches)
        For each camera: an image of a scene, or segments (npz, npy, csv, txt). They are matched
        with the current rig, and again with each refined rig until the matches do not change.
    rig
        The calibrated cameras, as `trinoc calibrate` writes them.
    matches
        Matches, as `trinoc match` writes them. They are not matched again.
    pose_model : (default: parameters with a covariance in the calibration)
        Pose parameters that are refined. aimed: pan, tilt, swing and distance. aim-free: also the
        point where the optical axis meets the sheet. rigid: all six.
    free_lens
        Refine focal lengths and principal points, too, even if the calibration has no covariance
        for them.
    moved : NAME (default: none)
        Cameras that have moved since the calibration. Their calibrated pose is not used as a prior.
    out
        File of the refined rig, with the cameras that occur in the matches.
    """
    from trinoc.calib.bundle.result import RefineStatus
    from trinoc.recording.camera_aliases import camera_aliases

    job.expect(trinoc.Rig, out)
    cameras = read_rig(rig)
    aliases = camera_aliases(cameras.names)
    scene = read_scene(images, matches, cameras, rig, job)
    LOGGER.info("refining the cameras of %d lines", len(scene.matches))
    matchers = [scene.tolerant, scene.strict] if moved else [scene.strict]
    result = trinoc.refine(
        cameras,
        scene.matches,
        pose_model=pose_model,
        free_lens=free_lens or None,
        moved=[aliases.get(name, name) for name in moved],
        match_again=[match for match in matchers if match is not None] or None,
    )
    if result.status is RefineStatus.AMBIGUOUS:
        raise CalibrationError(
            f"Other rigs than the refined {rig} explain the segments about as well, so nothing was "
            "written: calibrate again with the sheet, or take a scene with more edges."
        )
    if result.status is RefineStatus.NOT_CONVERGED:
        raise CalibrationError(
            f"The refinement of {rig} did not converge, so nothing was written: check that the "
            "matches were made with this rig, and match again."
        )
    provenance = job.provenance({"rig": rig, **scene.files})
    trinoc.save(result.rig, out, provenance=provenance, overwrite=True)
    return Outcome(result.summary(), _refine_record(result), written=(out,))


def _refine_record(result: "trinoc.calib.RefineResult") -> dict[str, Any]:
    """Summary of a refinement as a JSON object."""
    variances = result.covariance.diagonal()
    return {
        "status": result.status.name.lower(),
        **pick(result, "gauge", "segment_sigma_factor", "sheet_sigma_factor"),
        "parameters": {
            name: {"value": float(value), "sigma": float(max(variance, 0.0)) ** 0.5}
            for name, value, variance in zip(
                result.parameters, result.values, variances, strict=True
            )
        },
        "lines": len(result.lines),
        "log_posterior": list(result.history),
        "fragments_that_agree": int(result.inlier.sum()),
        "chi_square": dict(zip(("after", "before"), result.chi_square, strict=True)),
    }


def check(
    images: tuple[str, ...] = (),
    /,
    *,
    rig: Path,
    matches: Path | None = None,
    out: Path | None = None,
    job: Job,
) -> Outcome:
    """Test from images of a scene if a camera has moved since the calibration.

    Parameters
    ----------
    images : NAME=FILE (or --matches)
        For each camera: a current image of a scene, or segments (npz, npy, csv, txt). They are
        matched repeatedly, so that large motions are found, too.
    rig
        The calibrated cameras, as `trinoc calibrate` writes them.
    matches
        Matches of a current scene, as `trinoc match` writes them. They suffice for small motions.
    out
        File of the corrected rig, if one camera has moved and the scene determines its new pose.
    """
    job.expect(trinoc.Rig, out)
    cameras = read_rig(rig)
    scene = read_scene(images, matches, cameras, rig, job)
    LOGGER.info("checking the cameras of %d lines", len(scene.matches))
    matchers = [match for match in (scene.tolerant, scene.strict) if match is not None]
    result = trinoc.check_rig(cameras, scene.matches, match_again=matchers or None)
    refined = result.refined
    written = None if refined is None else out
    if refined is not None and written is not None:
        provenance = job.provenance({"rig": rig, **scene.files})
        trinoc.save(refined.rig, written, provenance=provenance, overwrite=True)
    record = {
        **pick(result, "conclusive", "moved"),
        "corrected": refined is not None,
        "sigmas": {motion.name: motion.sigmas for motion in result.motions},
    }
    return Outcome(result.summary(), record, written=(written,))


def compare(
    rig: Path,
    earlier: Path,
    /,
    *,
    job: Job,
) -> Outcome:
    """Report the differences between two calibrations of a rig with the same sheet pose.

    Parameters
    ----------
    rig : RIG.json
        The later calibration.
    earlier : EARLIER.json
        The earlier calibration.
    """
    from trinoc.calib.rig_check.comparison import compare_rigs
    from trinoc.report.report_table import text_table

    comparison = compare_rigs(read_rig(rig), read_rig(earlier))
    head = ("camera", "moved (mm)", "turned (deg)", "sigmas", "field (px)", "field (sigmas)")
    rows = [
        (
            name,
            f"{change.moved_mm:.4f}",
            f"{change.turned_deg:.5f}",
            _brief(change.sigmas),
            f"{change.field_px:.4f}",
            _brief(change.field_sigmas),
        )
        for name, change in comparison.cameras.items()
    ]
    record = {
        "moved": [name for name, change in comparison.cameras.items() if change.moved],
        "swapped": [list(pair) for pair in comparison.swapped],
        "cameras": as_json({n: change._asdict() for n, change in comparison.cameras.items()}),
    }
    return Outcome("\n".join([*comparison.sentences, text_table(head, rows)]), record)


def _brief(number: float) -> str:
    return f"{number:.1f}" if math.isfinite(number) else "not known"
