"""`trinoc match`: the pictures of a rig, or their segments, to matched 3-D segments."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import trinoc
from trinoc.cli.command import LOGGER, Job, Outcome, UsageError, plan_outcome
from trinoc.cli.options import Settings
from trinoc.cli.segments import ANYWHERE, depth_range, find_settings
from trinoc.cli.views import (
    SEGMENT_SUFFIXES,
    check_views,
    doubts_table,
    files_of_rig,
    find_doubts,
    named_files,
    read_rig,
    read_segments,
)
from trinoc.match.step_names import StepName

if TYPE_CHECKING:
    from trinoc.match.tracks.reliability import MatchAssessment


def match(
    images: tuple[str, ...],
    /,
    *,
    rig: Path,
    steps: tuple[StepName, ...] = (),
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] = ANYWHERE,
    find: Settings = (),
    dry_run: bool = False,
    report: Path | None = None,
    out: Path = Path("matches.npz"),
    job: Job,
) -> Outcome:
    """Match line segments across the images of a calibrated rig.

    Parameters
    ----------
    images : NAME=FILE
        For each camera: an image, an npz file of segments, or a table of segments x1 y1 x2 y2 (npy,
        csv, txt) from any detector. A header line may name more columns.
    rig
        The calibrated cameras, as `trinoc calibrate` writes them.
    steps : STEP... (default: none)
        Steps after matching. pixels: refine each line by the grey levels of all its views, which
        are more accurate than segments. rims: find circular rims of round bodies among chords of
        arcs. wireframe: build corners, edges and planar faces. Rims and a wire frame are written to
        files beside the matches.
    sigma_px : PX (default: that of each segment)
        Standard deviation of the segments' end points across the segment, the same for all.
    depth_range_mm : NEAR FAR (default: any depth in front of the cameras)
        Smallest and largest depth of the lines, in front of every camera that sees them.
    find
        Options of the segment detector, as in `trinoc segments`: tolerance_px=1.6, false_alarms=1,
        least_contrast=7, arcs=no, response=linear.
    dry_run
        Read and check all inputs, report what the command would do, and write nothing.
    report
        Write an HTML report to this file, too: verdict, cameras, residuals, uncertainty over the
        field, and matches.
    out
        File of the matches.
    """
    # Mistakes of usage come before any file is read.
    settings, depths_mm = find_settings(find), depth_range(depth_range_mm)
    if sigma_px is not None and not sigma_px > 0:
        raise UsageError(f"--sigma-px is {sigma_px:g}, but must be positive: no end is exact.")
    named_files(images, log=False)

    from trinoc.match.features import FEATURES
    from trinoc.match.steps import STEPS
    from trinoc.match.tracks.reliability import assess_matches
    from trinoc.report.features_part import features_record, features_text

    feature_files = {
        kind: out.with_name(f"{out.stem}-{kind.KIND}.npz")
        for kind in FEATURES
        if kind.KIND in steps
    }
    for kind, path in ((trinoc.Matches, out), *feature_files.items()):
        job.expect(kind, path, report)
    cameras = read_rig(rig)
    files = files_of_rig(images, cameras.names)
    check_views(files, cameras, rig)
    for name in steps:
        if STEPS[name].requirement:
            _check_pictures(files, f"--steps {name}")
    written = (out, *feature_files.values(), report)
    if dry_run:
        sizes = {name: cameras[name].image_size_px for name in files}
        return plan_outcome(f"match with {rig}", files, sizes, written)
    pictures, segments = read_segments(
        files, cameras, lambda picture: trinoc.find_segments(picture, **settings), job
    )
    LOGGER.info("matching %s", ", ".join(f"{len(s)} ({n})" for n, s in segments.items()))
    matches, segments, features = trinoc.match.improve(
        trinoc.match_segments(segments, cameras, sigma_px=sigma_px, depth_range_mm=depths_mm),
        segments,
        cameras,
        steps,
        pictures=pictures,
        arcs=lambda: {
            name: trinoc.find_segments(picture, **{**settings, "arcs": True})
            for name, picture in pictures.items()
        },
        depth_range_mm=depths_mm,
        response=settings["response"],
        begin=lambda step: LOGGER.info(step.description),
    )
    for feature in features.values():
        trinoc.save(feature, feature_files[type(feature)], overwrite=True)
    matches = trinoc.with_rig_covariance(matches, cameras)
    trinoc.save(matches, out, overwrite=True)
    doubts = find_doubts(rig)
    assessment = assess_matches(matches, doubts)
    job.write_report(
        report,
        job.provenance({**files, "rig": rig}),
        rig=cameras,
        segments=segments,
        matches=matches,
        scene_pictures=pictures,
        title="Matches",
        tables=doubts_table(rig),
        doubts=doubts,
        features=tuple(features.values()),
    )
    record = match_record(segments, matches, assessment)
    record |= {kind: features_record(feature) for kind, feature in features.items()}
    text = [match_text(matches), *map(features_text, features.values()), assessment.sentence]
    return Outcome("\n\n".join(text), record, refusal_of(assessment), written=written)


def _check_pictures(files: Mapping[str, Path], option: str) -> None:
    """Raise UsageError if a view has only segments, no picture. option : option that needs
    pictures.
    """
    for name, file in files.items():
        if file.suffix.lower() in SEGMENT_SUFFIXES:
            raise UsageError(
                f"{option} needs pictures, but {file} of {name} contains segments: give the "
                f"picture of {name}, or omit {option}."
            )


def refusal_of(assessment: "MatchAssessment") -> str | None:
    """Reason why the matching counts as failed; None for success."""
    from trinoc.match.tracks.matches import MatchStatus

    return assessment.deciding.explanation if assessment.status is MatchStatus.SUSPECT else None


def match_record(
    segments: "Mapping[str, trinoc.Segments]",
    matches: "trinoc.Matches",
    assessment: "MatchAssessment",
) -> dict[str, Any]:
    """Summary of a matching as a JSON object."""
    return {
        "segments": {name: len(segments_of_view) for name, segments_of_view in segments.items()},
        "tracks": {
            stage: int((matches.stage == stage).sum()) for stage in ("trinocular", "binocular")
        },
        "counts": {name: int(count) for name, count in matches.counts.items()},
        "reasons": {
            name: dict(Counter(map(str, reasons))) for name, reasons in matches.reasons.items()
        },
        "status": assessment.status.name.lower(),
        "verdict": assessment.sentence,
        "remarks": [finding.remedy for finding in assessment.findings if finding.remedy],
    }


def match_text(matches: "trinoc.Matches") -> str:
    """Summary of a matching as text, without the verdict."""
    from trinoc.report.text import counts_text, reasons_text

    in_three, in_two = (int((matches.stage == s).sum()) for s in ("trinocular", "binocular"))
    tracks = f"{in_three} tracks seen in three views or more, {in_two} in two."
    return "\n\n".join([counts_text(matches), reasons_text(matches), tracks])
