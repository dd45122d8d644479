"""`trinoc evaluate`: how accurate is the shape that segments give, against a known one?"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import Command, FileOrNone, Out, Outcome, UsageError
from trinoc.cli.progress import LOGGER
from trinoc.cli.views import SEGMENT_SUFFIXES, check_views, files_of_views, read_rig
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.evaluation.known_shape import KnownShape
    from trinoc.evaluation.sweep import Row
    from trinoc.geometry.rig import Rig


# Options that are settings of the segmentation.
KNOBS = ("tolerance_px", "false_alarms", "least_contrast")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluate(Command):
    """Compare 3-D segments with a known shape, for one or many settings of the segmentation."""

    pictures: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="NAME=IMG")]
    """For each camera its picture; or none, and --matches."""

    truth: Path
    """The known shape: edges (csv, json), OBJ, polylines (txt), or truth.json of a made scene."""

    rig: FileOrNone = None
    """The cameras; their covariance joins that of the segments. Pictures need it."""

    matches: FileOrNone = None
    """Matches of `trinoc match`, in place of pictures."""

    tolerance_px: tuple[float, ...] = (1.6,)
    """Of the segmentation: coarsest deviation of an edge from a straight line."""

    false_alarms: tuple[float, ...] = (1.0,)
    """Of the segmentation: segments that noise alone may bring about in a picture."""

    least_contrast: tuple[float, ...] = (7.0,)
    """Of the segmentation: fainter edges are left out."""

    least_posterior: tuple[float, ...] = (0.0,)
    """Only tracks of this probability or more."""

    stages: tuple[Literal["all", "trinocular"], ...] = ("all",)
    """All tracks, or only those seen in three views."""

    forms: tuple[Literal["tracks", "joined", "corners", "wireframe"], ...] = ("tracks",)
    """Tracks one by one, joined to straight lines, these carried to the corners they meet in, or
    all as a wire frame, whose corners and edges are counted, too."""

    within_mm: tuple[float, ...] = (0.1, 0.25, 0.5, 1.0)
    """Distances at which precision and completeness are given."""

    unit_mm: float = 1.0
    """Length in mm of one unit of the known shape's file."""

    crease_deg: float = 30.0
    """Of an OBJ: faces that turn by more than this meet in an edge."""

    grey_step: float = 8.0
    """Of a made scene: an edge with less across it counts as not shown."""

    align: bool = False
    """First lay the segments on the shape by a rigid motion; figures are then those after it."""

    out: Out = Path("evaluation.csv")
    """Where the table goes; it grows with every setting."""

    plot: FileOrNone = None
    """Also draw it: png, svg or pdf."""

    def run(self, command_line: str) -> Outcome:
        """Evaluate every setting, and write the table after each."""
        files = files_of_views(self.pictures, guess=True)
        self._check_usage(bool(files))

        from trinoc.io.atomic import expect_place
        from trinoc.io.known_shape import load_shape
        from trinoc.io.table_csv import save_table
        from trinoc.report.text_of_evaluation import evaluation_text

        expect_place(self.out, self.plot)
        if self.plot is not None:
            from trinoc.report.evaluation_plot import expect_plotter

            expect_plotter(self.plot)
        shape = load_shape(
            self.truth,
            unit_mm=self.unit_mm,
            crease_deg=self.crease_deg,
            grey_step=self.grey_step,
        )
        rig = None if self.rig is None else read_rig(self.rig)
        if rig is not None and shape.wants_every_edge:
            shape = shape.seen_by(rig)
        rows: list[Row] = []
        for row in self._rows(files, rig, shape):
            rows.append(row)
            save_table([done.record() for done in rows], self.out)
        if all(row.evaluation is None for row in rows):
            raise InputError(f"No setting could be evaluated; the first: {rows[0].problem}")
        if self.plot is not None:
            from trinoc.report.evaluation_plot import write_plot

            write_plot(rows, self.plot)
        record = {
            "wanted": shape.wanted,
            "aligned": self.align,
            "rows": [_finite(row.record()) for row in rows],
            "edges": [_edges(row) for row in rows],
            "motions": [_motion(row) for row in rows],
        }
        return Outcome(evaluation_text(rows), record, written=(self.out, self.plot))

    def _check_usage(self, has_pictures: bool) -> None:
        if has_pictures == (self.matches is not None):
            raise UsageError("Give either NAME=IMG for each camera with --rig, or --matches.")
        swept = {name: getattr(self, name) for name in KNOBS}
        if self.matches is not None and swept != {name: getattr(Evaluate, name) for name in KNOBS}:
            raise UsageError(
                "Matches were made with a setting of the segmentation already: give the pictures "
                "to try others."
            )
        if self.rig is None and self.forms != ("tracks",):
            raise UsageError("Lines are joined by what the cameras saw of them: add --rig.")
        if not all((*swept.values(), self.least_posterior, self.stages, self.forms)):
            raise UsageError("An option without a value: give one or more, or leave it out.")

    def _rows(
        self, files: dict[str, Path], rig: "Rig | None", shape: "KnownShape"
    ) -> "Iterator[Row]":
        from trinoc.evaluation.sweep import evaluate_matches, evaluate_settings, settings_of

        choices = self._choices()
        if self.matches is not None:
            from trinoc.io.saving import load_matches

            matches = load_matches(self.matches)
            yield from evaluate_matches(
                matches, rig, shape, choices, tolerances_mm=self.within_mm, aligned=self.align
            )
            return
        from trinoc.io.images import read_views
        from trinoc.io.views_of_rig import expect_size

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
        settings = settings_of(*(getattr(self, name) for name in KNOBS))
        rows = evaluate_settings(
            pictures,
            rig,
            shape,
            settings,
            choices,
            tolerances_mm=self.within_mm,
            aligned=self.align,
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

    def _choices(self) -> "Sequence[Choice]":
        from trinoc.evaluation.sweep import SweepSetting

        return [
            SweepSetting(least, stage, form)
            for form in self.forms
            for stage in self.stages
            for least in self.least_posterior
        ]


def _finite(record: dict[str, Any]) -> dict[str, Any]:
    """As JSON can hold it: null for NaN."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in record.items()
    }


def _edges(row: "Row") -> list[dict[str, Any]]:
    """The edges that ought to be found from end to end, one by one."""
    if row.evaluation is None:
        return []
    lengths = row.evaluation.lengths
    return [
        _finite(dict(zip(lengths._fields, map(_plain, values), strict=True)))
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
