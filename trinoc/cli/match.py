"""`trinoc match`: the pictures of a rig, or their segments, to matched 3-D segments."""

import dataclasses
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from trinoc.cli.command import LOGGER, Command, DryRunOption, Out, Outcome, ReportOption, UsageError
from trinoc.cli.segments import DepthOption, FindOption
from trinoc.cli.views import (
    SEGMENT_SUFFIXES,
    check_views,
    doubts_table,
    files_of_rig,
    files_of_views,
    find_doubts,
    read_rig,
    read_segments,
)
from trinoc.match.step_names import StepName

if TYPE_CHECKING:
    from trinoc.geometry.segments import Segments
    from trinoc.match.tracks.matches import Matches
    from trinoc.match.tracks.reliability import MatchAssessment


@dataclasses.dataclass(frozen=True, kw_only=True)
class MatchOptions(DepthOption, FindOption):
    """Options of the steps from segments to tracks and features."""

    steps: Annotated[
        tuple[StepName, ...], tyro.conf.arg(metavar="STEP...", help_behavior_hint="(default: none)")
    ] = ()
    """What to do after matching. pixels: place the lines by the grey levels of all their views,
    which are more exact than segments. rims: find the circular rims of round bodies among the
    chords of arcs, and add pieces of them. wireframe: put corners, edges and planar faces together.
    Rims and a wire frame are written beside the matches."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class MatchCommand(MatchOptions, DryRunOption, ReportOption, Command):
    """Match line segments across the pictures of a calibrated rig."""

    images: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="NAME=FILE", help_behavior_hint="(required)"),
    ]
    """For each camera its picture, or segments found before (npz), or a table x1 y1 x2 y2
    (npy, csv, txt) of any detector, whose heading may name other columns."""

    rig: Path
    """The cameras, as `trinoc calibrate` writes them."""

    out: Out = Path("matches.npz")
    """Where the matches go."""

    def run(self, command_line: str) -> Outcome:
        """Match and write the matches."""
        # Mistakes of usage come before any file is read; the names are said with the rig's below.
        settings = self.find_settings()
        if not files_of_views(self.images, guess=True, say=False):
            raise UsageError("No picture is given: write NAME=FILE for each camera.")
        depths = self.depths_mm()

        from trinoc.cli.command import provenance
        from trinoc.evaluation.lines_of_rig import with_rig_covariance
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable, save
        from trinoc.match.features import FEATURES
        from trinoc.match.matcher import match_segments
        from trinoc.match.steps import STEPS, improve
        from trinoc.match.tracks.matches import Matches
        from trinoc.match.tracks.reliability import assess_matches
        from trinoc.report.features_part import features_record, features_text

        kept = [kind for kind in FEATURES if kind.KIND in self.steps]
        places = [self.out, *(self.place_of(kind.KIND) for kind in kept), self.report]
        expect_place(*places)
        for place, kind in zip(places[:-1], (Matches, *kept), strict=True):
            expect_replaceable(place, kind, force=self.force)
        rig = read_rig(self.rig)
        files = files_of_rig(self.images, rig.names)
        check_views(files, rig, self.rig)
        for name in self.steps:
            if STEPS[name].requirement:
                _check_pictures(files, f"--steps {name}")
        if self.dry_run:
            sizes = {name: rig[name].image_size_px for name in files}
            return self.plan(f"match with {self.rig}", files, sizes, places)
        images, segments = read_segments(files, rig, self.find_in, quiet=self.quiet)
        LOGGER.info("matching %s", ", ".join(f"{len(s)} ({n})" for n, s in segments.items()))
        matches, segments, features = improve(
            match_segments(segments, rig, depth_range_mm=depths),
            segments,
            rig,
            self.steps,
            pictures=images,
            arcs=lambda: {n: self.find_in(image, arcs=True) for n, image in images.items()},
            depth_range_mm=depths,
            response=settings["response"],
            begin=lambda step: LOGGER.info(step.description),
        )
        for kind, own in features.items():
            save(own, self.place_of(kind), overwrite=True)
        matches = with_rig_covariance(matches, rig)
        save(matches, self.out, overwrite=True)
        doubts = find_doubts(self.rig)
        assessment = assess_matches(matches, doubts)
        self.write_report(
            provenance(command_line, {**files, "rig": self.rig}),
            rig=rig,
            segments=segments,
            matches=matches,
            scene_pictures=images,
            title="Matches",
            tables=doubts_table(self.rig),
            doubts=doubts,
            features=tuple(features.values()),
        )
        text, record = [match_text(matches)], match_record(segments, matches, assessment)
        for kind, own in features.items():
            text.append(features_text(own))
            record[kind] = features_record(own)
        text.append(assessment.sentence)
        return Outcome("\n\n".join(text), record, refusal_of(assessment), written=places)

    def place_of(self, kind: str) -> Path:
        """Where features of a kind go: beside the matches."""
        return self.out.with_name(f"{self.out.stem}-{kind}.npz")


def _check_pictures(files: Mapping[str, Path], option: str) -> None:
    """Raise UsageError where a view is given by its segments alone."""
    for name, file in files.items():
        if file.suffix.lower() in SEGMENT_SUFFIXES:
            raise UsageError(
                f"{option} needs pictures, but {file} of {name} holds segments: give its picture, "
                f"or leave {option} out."
            )


def refusal_of(assessment: "MatchAssessment") -> str | None:
    """Why a matching counts as failed; None where it does not."""
    from trinoc.match.tracks.matches import MatchStatus

    return assessment.deciding.explanation if assessment.status is MatchStatus.SUSPECT else None


def match_record(
    segments: "Mapping[str, Segments]", matches: "Matches", assessment: "MatchAssessment"
) -> dict[str, Any]:
    """What programs want to know of a matching, as JSON can hold it."""
    return {
        "segments": {name: len(found) for name, found in segments.items()},
        "tracks": {
            "trinocular": int((matches.stage == "trinocular").sum()),
            "binocular": int((matches.stage == "binocular").sum()),
        },
        "counts": {name: int(count) for name, count in matches.counts.items()},
        "reasons": {
            name: dict(Counter(str(word) for word in words))
            for name, words in matches.reasons.items()
        },
        "status": assessment.status.name.lower(),
        "verdict": assessment.sentence,
        "remarks": [finding.remedy for finding in assessment.findings if finding.remedy],
    }


def match_text(matches: "Matches") -> str:
    """What a matching found, for people; the verdict is not in it."""
    from trinoc.report.text import counts_text, reasons_text

    in_three, in_two = (int((matches.stage == s).sum()) for s in ("trinocular", "binocular"))
    parts = [
        counts_text(matches),
        reasons_text(matches),
        f"{in_three} tracks seen in three views or more, {in_two} in two.",
    ]
    return "\n\n".join(parts)
