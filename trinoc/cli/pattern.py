"""`trinoc pattern`: a sheet or board to print, with the layout that other commands read."""

import dataclasses
import importlib.util
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from trinoc.cli.command import Command, Outcome, UsageError

if TYPE_CHECKING:
    from trinoc.calib.targets.abstract_target import AbstractBoard
    from trinoc.calib.targets.printing import SheetProposal
from typing import NamedTuple

_MM_PER_INCH = 25.4
# Glasses for virtual reality have pixels of .01 mm, walls of diodes of 4 mm.
_PITCHES_MM = (0.005, 5.0)
_MOST_PX = 20_000


class ScreenOptions(NamedTuple):
    """What the user says of the screen; a size of (0, 0) and None where nothing is said."""

    size_px: tuple[int, int]
    inch: float | None
    pitch_mm: float | None

    def checked_pitch_mm(self, *, is_meant: bool) -> float | None:
        """From one pixel to the next; None where no screen is meant. Raises UsageError."""
        said = self.size_px != (0, 0) or self.inch is not None or self.pitch_mm is not None
        if not is_meant:
            if said:
                raise UsageError("--screen-... is of a screen as target: give -o FILE.png, too.")
            return None
        if not all(0 < side <= _MOST_PX for side in self.size_px):
            raise UsageError(
                "A PNG is made for one screen: give its width and height, such as "
                "--screen-px 1920 1080."
            )
        if (self.inch is None) == (self.pitch_mm is None):
            raise UsageError(
                "How large the pixels of the screen are, one of two says: give --screen-inch, its "
                "diagonal, such as 24, or --screen-pitch-mm, such as 0.27."
            )
        pitch_mm = self.pitch_mm
        if self.inch is not None:
            pitch_mm = self.inch * _MM_PER_INCH / math.hypot(*self.size_px)
        least, most = _PITCHES_MM
        if pitch_mm is None or not least <= pitch_mm <= most:
            raise UsageError(
                f"Pixels of {pitch_mm:g} mm are on no screen: the diagonal is in inches, the pitch "
                "in millimetres."
            )
        return pitch_mm


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pattern(Command):
    """Make a sheet of circles and crossed lines, or a board: its layout, and drawings to print."""

    board: Annotated[str, tyro.conf.arg(metavar="KIND")] = "sheet"
    """What to draw: the sheet of `trinoc calibrate`, or a board of squares or tags for
    `calibrate-rig`: chessboard, charuco, aprilgrid."""

    rows: int = 8
    """Circles from top to bottom; even, so that no line meets a circle. Of a board, squares or
    tags."""

    columns: int = 8
    """Circles from left to right; even, too. Of a board, squares or tags."""

    square_mm: float = 20.0
    """Side of a board's squares."""

    marker_mm: Annotated[
        float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="(default: 3/4 of it)")
    ] = None
    """Side of a ChArUco board's markers."""

    tag_mm: float = 16.0
    """Side of an AprilGrid's tags."""

    tag_spacing: float = 0.3
    """Gap between an AprilGrid's tags over their side, as Kalibr has it."""

    dictionary: Annotated[
        str | None,
        tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: 4x4_250; APRILTAG_36h11)"),
    ] = None
    """Of a ChArUco board's markers or an AprilGrid's tags, by OpenCV's name."""

    first: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Number of a ChArUco board's or an AprilGrid's first marker, so that several boards fixed to
    each other are told apart."""

    pitch_mm: float = 20.0
    """Distance between the centres of neighbours."""

    radius_mm: float = 6.0
    """Radius of the circles."""

    line_style: Literal["stop", "through", "white"] = "stop"
    """Where a line of an odd grid meets a circle: it stops before it, runs through it in black,
    or runs through it in white."""

    for_distance_mm: Annotated[
        float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="(default: as stated)")
    ] = None
    """Choose number, pitch and radius of the circles for a camera that looks at the sheet from so
    far. Give its --field-deg and --image-size-px, too."""

    field_deg: Annotated[
        float | None, tyro.conf.arg(metavar="DEG", help_behavior_hint="(default: none)")
    ] = None
    """Angle that the camera sees from the left to the right edge of its picture: for a focal
    length f and a sensor w wide, 2 atan(w / 2f)."""

    image_size_px: Annotated[
        tuple[int, int], tyro.conf.arg(metavar="W H", help_behavior_hint="(default: none)")
    ] = (0, 0)
    """Width and height of the camera's pictures."""

    paper: Literal["a4", "letter", "a3", "a2", "a1", "a0"] = "a4"
    """Paper of the drawings."""

    screen_px: Annotated[
        tuple[int, int], tyro.conf.arg(metavar="W H", help_behavior_hint="(default: none)")
    ] = (0, 0)
    """For -o FILE.png, a screen as target: width and height of the screen."""

    screen_inch: Annotated[
        float | None, tyro.conf.arg(metavar="INCH", help_behavior_hint="(default: none)")
    ] = None
    """Diagonal of the screen, which says how large its pixels are."""

    screen_pitch_mm: Annotated[
        float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="(default: none)")
    ] = None
    """Instead of the diagonal: from one pixel of the screen to the next."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",), metavar="FILE")] = Path("pattern.json")
    """Where the layout goes, a .json. The drawings, .svg and .pdf, go beside it. A .png is the
    picture for a screen, with its layout beside it."""

    def run(self, command_line: str) -> Outcome:
        """Write the files."""
        kind = self.out.suffix.lower()
        if kind not in (".json", ".png"):
            raise UsageError(
                f"{self.out}: a layout is JSON: choose a name that ends in .json, or in .png for "
                "a screen as target."
            )
        screen = ScreenOptions(self.screen_px, self.screen_inch, self.screen_pitch_mm)
        pitch_mm = screen.checked_pitch_mm(is_meant=kind == ".png")
        proposal = self._proposal(pitch_mm)
        sheet = self._board(proposal)
        if pitch_mm is None:
            written, notes = self._print(sheet)
        else:
            written, notes = self._show(sheet, pitch_mm)
        if proposal is not None:
            said = (
                f"Circles are {proposal.circle_px:.0f} px wide, and the sheet takes "
                f"{proposal.field_share:.0%} of the shorter side, from {self.for_distance_mm:g} mm."
            )
            notes = [said, *notes]
        text = f"{len(sheet)} {sheet.places}, {sheet.name}\n" + "\n".join(notes)
        record = {"name": sheet.name, sheet.places: len(sheet)}
        return Outcome(text, record, written=written)

    def _print(self, sheet: "AbstractBoard") -> tuple[list[Path], list[str]]:
        """Layout and drawings on paper: the files, and what to do with them."""
        from trinoc.io.board_json import save_target
        from trinoc.io.pattern_pdf import save_pattern_pdf
        from trinoc.io.pattern_svg import save_pattern_svg

        drawing, page = self.out.with_suffix(".svg"), self.out.with_suffix(".pdf")
        # First the drawing, which fails where the sheet is larger than the paper.
        save_pattern_svg(sheet, drawing, paper=self.paper)
        save_target(sheet, self.out)
        side = "tag" if self.board == "aprilgrid" else "square"
        notes = [f"Print at 100 %, and give the side of a {side} as you measure it."]
        if self.board == "sheet":
            notes = [
                "Print at 100 %, measure the two scale bars, and give measured over nominal length",
                "to `trinoc calibrate --print-scale`.",
            ]
        if importlib.util.find_spec("reportlab") is None:
            notes.append("No PDF, because reportlab is missing: pip install 'trinoc[print]'.")
            return [self.out, drawing], notes
        save_pattern_pdf(sheet, page, paper=self.paper)
        return [self.out, drawing, page], notes

    def _show(self, sheet: "AbstractBoard", pitch_mm: float) -> tuple[list[Path], list[str]]:
        """Picture for the screen and layout: the files, and what to do with them."""
        from trinoc.io.board_json import save_target
        from trinoc.io.pattern_page import drawing_size_mm
        from trinoc.io.pattern_png import save_pattern_png

        layout = self.out.with_suffix(".json")
        save_pattern_png(sheet, self.out, size_px=self.screen_px, pitch_mm=pitch_mm)
        save_target(sheet, layout)
        width, height = drawing_size_mm(sheet)
        notes = [
            f"Pixels of {pitch_mm:.4f} mm. Show it full screen at 100 %, with no scaling by the "
            "desktop or the viewer.",
            f"From outer edge to outer edge the ink is {width:.1f} x {height:.1f} mm: measure it "
            + (
                "and give measured\nover nominal length to `trinoc calibrate --print-scale`."
                if self.board == "sheet"
                else "on the screen."
            ),
        ]
        return [self.out, layout], notes

    def _proposal(self, screen_pitch_mm: float | None) -> "SheetProposal | None":
        if self.for_distance_mm is None:
            return None
        if self.board != "sheet":
            raise UsageError(
                "--for-distance-mm is of the sheet: give --square-mm or --tag-mm of a board."
            )
        width, height = self.image_size_px
        angle = self.field_deg
        if self.for_distance_mm <= 0:
            raise UsageError(
                f"--for-distance-mm is {self.for_distance_mm:g}: give the distance from the camera "
                "to the sheet."
            )
        if angle is not None and not 0 < angle < 170:
            raise UsageError(f"--field-deg is {angle:g}: give an angle above 0 and below 170.")
        if angle is None or min(width, height) <= 0:
            raise UsageError(
                "--for-distance-mm needs the camera: give --field-deg, such as 30, and "
                "--image-size-px, such as 1280 960."
            )

        from trinoc.calib.targets.printing import propose_sheet
        from trinoc.io.pattern_page import drawing_room_mm
        from trinoc.io.pattern_png import screen_room_mm

        across = 2 * self.for_distance_mm * math.tan(math.radians(angle) / 2)
        return propose_sheet(
            field_mm=(across, across * height / width),
            size_px=(width, height),
            room_mm=(
                drawing_room_mm(self.paper)
                if screen_pitch_mm is None
                else screen_room_mm(self.screen_px, screen_pitch_mm)
            ),
        )

    def _board(self, proposal: "SheetProposal | None") -> "AbstractBoard":
        from trinoc.calib.targets.board_set import BOARDS
        from trinoc.calib.targets.checkers import Chessboard
        from trinoc.calib.targets.pattern import Pattern as Sheet

        if self.board == Sheet.kind:
            sizes = (self.rows, self.columns, self.pitch_mm, self.radius_mm)
            if proposal is not None:
                sizes = (proposal.count, proposal.count, proposal.pitch_mm, proposal.radius_mm)
            rows, columns, pitch_mm, radius_mm = sizes
            return Sheet.cross_grid(
                rows=rows,
                columns=columns,
                pitch_mm=pitch_mm,
                radius_mm=radius_mm,
                line_style=self.line_style,
            )
        if self.board not in BOARDS:
            raise UsageError(f"--board is {self.board!r}: give one of {', '.join(BOARDS)}.")
        board = BOARDS[self.board]
        # A chessboard counts its inner corners.
        beyond = 1 if board is Chessboard else 0
        options = {
            "rows": self.rows - beyond,
            "columns": self.columns - beyond,
            "square_mm": self.square_mm,
            "marker_mm": self.marker_mm,
            "tag_mm": self.tag_mm,
            "spacing": self.tag_spacing,
            "dictionary": self.dictionary,
            "first": self.first,
        }
        fields = board.layout.values()
        return board(**{k: v for k, v in options.items() if k in fields and v is not None})
