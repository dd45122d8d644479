"""`trinoc evaluate`: how accurate is the shape that segments give, against a known one?"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from trinoc.cli.command import LOGGER, Command, FileOrNone, Out, Outcome, UsageError, with_nulls
from trinoc.cli.segments import FIND, usual_find
from trinoc.cli.settings import (
    Settings,
    parse_list,
    parse_number,
    parse_truth,
    parse_word,
    read_settings,
)
from trinoc.cli.views import SEGMENT_SUFFIXES, check_views, files_of_views, read_rig
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.evaluation.known_shape import KnownShape
    from trinoc.evaluation.sweep import Row, SweepSetting
    from trinoc.geometry.rig import Rig


# Settings of the segmentation that are tried.
TRIED = ("tolerance_px", "false_alarms", "least_contrast")
TRIED_FIND = {name: parse_list(FIND[name]) for name in TRIED}
LINES = {
    "form": parse_list(parse_word("tracks", "joined", "corners", "wireframe")),
    "stage": parse_list(parse_word("all", "trinocular")),
    "least_posterior": parse_list(parse_number),
}
SHAPE: Mapping[str, Callable[[str], Any]] = {
    **dict.fromkeys(("unit_mm", "crease_deg", "grey_step"), parse_number),
    "align": parse_truth,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluateCommand(Command):
    """Compare 3-D segments with a known shape, for one or many settings of the segmentation."""

    images: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="NAME=IMG")]
    """For each camera its picture; or none, and --matches."""

    truth: Path
    """The known shape: edges (csv, json), OBJ, polylines (txt), or truth.json of a made scene."""

    rig: FileOrNone = None
    """The cameras; their covariance joins that of the segments. Pictures need it."""

    matches: FileOrNone = None
    """Matches of `trinoc match`, in place of pictures."""

    find: Settings = ()
    """How segments are found, each setting with one value or with several to try, commas between:
    tolerance_px=1.6, false_alarms=1, least_contrast=7."""

    lines: Settings = ()
    """Which lines are compared, each setting with one value or with several to try. form=tracks:
    tracks one by one; joined: to straight lines; corners: these carried to the corners they meet
    in; wireframe: all as a wire frame, whose corners and edges are counted, too. stage=all, or
    trinocular. least_posterior=0: only tracks of this probability or more."""

    within_mm: tuple[float, ...] = (0.1, 0.25, 0.5, 1.0)
    """Distances at which precision and completeness are given."""

    shape: Settings = ()
    """How the known shape is read: unit_mm=1 (length of one unit of its file), crease_deg=30 (faces
    of an OBJ that turn by more meet in an edge), grey_step=8 (an edge of a made scene with less
    across it counts as not shown). align=yes: first lay the segments on it by a rigid motion;
    figures are then those after it."""

    out: Out = Path("evaluation.csv")
    """Where the table goes; it grows with every setting."""

    plot: FileOrNone = None
    """Also draw it: png, svg or pdf."""

    def run(self, command_line: str) -> Outcome:
        """Evaluate every setting, and write the table after each."""
        self._check_usage()
        files = files_of_views(self.images, guess=True)

        from trinoc.io.atomic import expect_place, save_table
        from trinoc.io.known_shape import load_shape
        from trinoc.io.saving import expect_marked
        from trinoc.report.evaluations import evaluation_text

        expect_place(self.out, self.plot)
        # Every table of this command has this column.
        expect_marked(self.out, b"least_posterior", force=self.force)
        if self.plot is not None:
            from trinoc.report.evaluations import expect_plotter

            expect_plotter(self.plot)
        stated = read_settings("--shape", self.shape, SHAPE)
        aligned = stated.pop("align", False)
        shape = load_shape(self.truth, **stated)
        rig = None if self.rig is None else read_rig(self.rig)
        if rig is not None and shape.wants_every_edge:
            shape = shape.seen_by(rig)
        rows: list[Row] = []
        for row in self._rows(files, rig, shape, aligned=aligned):
            rows.append(row)
            save_table([done.record() for done in rows], self.out)
        if all(row.evaluation is None for row in rows):
            raise InputError(f"No setting could be evaluated; the first: {rows[0].problem}")
        if self.plot is not None:
            from trinoc.report.evaluations import write_plot

            write_plot(rows, self.plot)
        record = {
            "wanted": shape.wanted,
            "aligned": aligned,
            "rows": [with_nulls(row.record()) for row in rows],
            "edges": [_edges(row) for row in rows],
            "motions": [_motion(row) for row in rows],
        }
        return Outcome(evaluation_text(rows), record, written=(self.out, self.plot))

    def _check_usage(self) -> None:
        self._find_settings()
        read_settings("--shape", self.shape, SHAPE)
        forms = {choice.form for choice in self._choices()}
        if bool(self.images) == (self.matches is not None):
            raise UsageError("Give either NAME=IMG for each camera with --rig, or --matches.")
        if self.matches is not None and self.find:
            raise UsageError(
                "Matches were made with a setting of the segmentation already: give the pictures "
                "to try others."
            )
        if not self.within_mm:
            raise UsageError("--within-mm has no distance: give one or more, or leave it out.")
        if self.rig is None and forms != {"tracks"}:
            raise UsageError("Lines are joined by what the cameras saw of them: add --rig.")

    def _find_settings(self) -> list[tuple[float, ...]]:
        """The values of each setting of the segmentation. Raises UsageError."""
        stated = read_settings("--find", self.find, TRIED_FIND)
        return [stated.get(name, (usual_find()[name],)) for name in TRIED]

    def _rows(
        self, files: dict[str, Path], rig: "Rig | None", shape: "KnownShape", *, aligned: bool
    ) -> "Iterator[Row]":
        from trinoc.evaluation.sweep import evaluate_matches, evaluate_settings, list_settings

        choices = self._choices()
        if self.matches is not None:
            from trinoc.io.saving import load_matches

            matches = load_matches(self.matches)
            yield from evaluate_matches(
                matches, rig, shape, choices, tolerances_mm=self.within_mm, aligned=aligned
            )
            return
        from trinoc.io.images import expect_size, read_views

        if rig is None or self.rig is None:
            raise UsageError("The rig that took the pictures is not given: add --rig rig.json.")
        for name, file in files.items():
            if file.suffix.lower() in SEGMENT_SUFFIXES:
                raise InputError(
                    f'{file} holds segments of "{name}", but settings are tried on pictures: give '
                    "pictures, or --matches."
                )
        check_views(files, rig, self.rig)
        pictures = read_views(files)
        for name, picture in pictures.items():
            expect_size(name, picture, rig)
        settings = list_settings(*self._find_settings())
        rows = evaluate_settings(
            pictures,
            rig,
            shape,
            settings,
            choices,
            tolerances_mm=self.within_mm,
            aligned=aligned,
        )
        for number, row in enumerate(rows):
            if number % len(choices) == 0 and row.setting is not None:
                LOGGER.info(
                    "%d of %d: tolerance %g px, false alarms %g, least contrast %g: %d segments",
                    number // len(choices) + 1,
                    len(settings),
                    *row.setting,
                    row.segments,
                )
            if row.problem:
                LOGGER.warning("%s", row.problem)
            yield row

    def _choices(self) -> "Sequence[SweepSetting]":
        from trinoc.evaluation.sweep import SweepSetting

        stated = read_settings("--lines", self.lines, LINES)
        usual = SweepSetting()
        return [
            SweepSetting(least, stage, form)
            for form in stated.get("form", (usual.form,))
            for stage in stated.get("stage", (usual.stage,))
            for least in stated.get("least_posterior", (usual.least_posterior,))
        ]


def _edges(row: "Row") -> list[dict[str, Any]]:
    """The edges that ought to be found from end to end, one by one."""
    if row.evaluation is None:
        return []
    lengths = row.evaluation.lengths
    return [
        with_nulls(dict(zip(lengths._fields, map(_plain, values), strict=True)))
        for values in zip(*lengths, strict=True)
    ]


def _plain(number: Any) -> int | float:
    return number.item()


def _motion(row: "Row") -> dict[str, Any] | None:
    """What laid the segments on the shape."""
    motion = None if row.evaluation is None else row.evaluation.motion
    if motion is None:
        return None
    return {
        "rotation": motion.rotation.tolist(),
        "shift_mm": motion.shift_mm.tolist(),
        "turn_deg": motion.turn_deg,
        "rank": motion.rank,
    }
