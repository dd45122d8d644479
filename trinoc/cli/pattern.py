"""`trinoc pattern`: a sheet or board to print, with the layout that other commands read."""

import dataclasses
import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import tyro

from trinoc.cli.command import Command, Outcome, UsageError
from trinoc.cli.settings import (
    Settings,
    parse_integer,
    parse_number,
    parse_pair,
    parse_truth,
    parse_word,
    read_settings,
)
from trinoc.errors import InputError

if TYPE_CHECKING:
    from trinoc.calib.targets.abstract_target import AbstractBoard
    from trinoc.calib.targets.printing import SheetProposal

Count = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 8)")]

_MM_PER_INCH = 25.4
# Glasses for virtual reality have pixels of .01 mm, walls of diodes of 4 mm.
_PITCHES_MM = (0.005, 5.0)
_MOST_PX = 20_000

SHEET = "sheet"
CAMERA = {
    "distance_mm": parse_number,
    "field_deg": parse_number,
    "size_px": parse_pair(parse_integer),
}
SCREEN = {
    "size_px": parse_pair(parse_integer),
    "diagonal_inch": parse_number,
    "pitch_mm": parse_number,
}
# Of the numbers that boards have as fields.
_PARSERS: Mapping[Any, Callable[[str], Any]] = {
    int: parse_integer,
    float: parse_number,
    bool: parse_truth,
    str: str,
}
# What a board has where nothing is said.
_USUAL = {"square_mm": 20.0, "tag_mm": 16.0}
_COUNT = 8
_SHEET_SIZES = {"pitch_mm": 20.0, "radius_mm": 6.0}
_SHEET = {
    **dict.fromkeys(_SHEET_SIZES, parse_number),
    "line_style": parse_word("stop", "through", "white"),
}
# Of a sheet, what --camera chooses.
_CHOSEN = tuple(f"{name}=" for name in _SHEET_SIZES)


class Screen(NamedTuple):
    """A screen as target: its size, and from one of its pixels to the next."""

    size_px: tuple[int, int]
    pitch_mm: float


def read_screen(words: tuple[tuple[str, ...], ...], *, is_meant: bool) -> Screen | None:
    """The screen that --screen states; None where no screen is meant. Raises UsageError."""
    said = read_settings("--screen", words, SCREEN)
    if not is_meant:
        if said:
            raise UsageError("--screen is of a screen as target: give -o FILE.png, too.")
        return None
    size_px = said.get("size_px", (0, 0))
    if not all(0 < side <= _MOST_PX for side in size_px):
        raise UsageError(
            "A PNG is made for one screen: give its width and height, such as --screen "
            "size_px=1920,1080 diagonal_inch=24."
        )
    if ("diagonal_inch" in said) == ("pitch_mm" in said):
        raise UsageError(
            "How large the pixels of the screen are, one of two says: give --screen "
            "diagonal_inch=INCH, such as 24, or --screen pitch_mm=MM, such as 0.27."
        )
    pitch_mm = said.get("pitch_mm")
    if pitch_mm is None:
        pitch_mm = said["diagonal_inch"] * _MM_PER_INCH / math.hypot(*size_px)
    least, most = _PITCHES_MM
    if not least <= pitch_mm <= most:
        raise UsageError(
            f"Pixels of {pitch_mm:g} mm are on no screen: the diagonal is in inches, the pitch in "
            "millimetres."
        )
    return Screen(size_px, pitch_mm)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PatternCommand(Command):
    """Make a sheet of circles and crossed lines, or a board: its layout, and drawings to print."""

    layout: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="KIND|LAYOUT.json NAME=VALUE", help_behavior_hint="(default: sheet)"),
    ] = ()
    """What to draw: the sheet of `trinoc calibrate`, or a board for `calibrate-rig`: chessboard,
    charuco, aprilgrid; or a layout (JSON) that is there already. Behind the kind what else it has,
    as in its layout: of a sheet pitch_mm=20 (between the centres of neighbouring circles)
    radius_mm=6 line_style=stop|through|white (where a line of an odd grid meets a circle: it stops
    before it, runs through it in black or in white); of a chessboard square_mm=20; of a charuco
    board square_mm=20 marker_mm=15 dictionary=4x4_250 first=0 legacy=no inverted=no (white for
    black) mirrored=no (as in a mirror, for the back of a two-sided board); of an aprilgrid
    tag_mm=16 spacing=0.3 (gap over tag) dictionary=APRILTAG_36h11 first=0 border=2. first is the
    number of the first marker, by which boards fixed to each other are told apart."""

    rows: Count = None
    """Circles from top to bottom; even, so that no line meets a circle. Of a board, squares or
    tags."""

    columns: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 8)")
    ] = None
    """Circles from left to right; even, too. Of a board, squares or tags."""

    camera: Settings = ()
    """Choose number, pitch and radius of the circles for a camera: distance_mm=500 (from which it
    looks at the sheet), field_deg=30 (that it sees from left to right: for a focal length f and a
    sensor w wide, 2 atan(w / 2f)), size_px=1280,960 (of its pictures)."""

    paper: Literal["a4", "letter", "a3", "a2", "a1", "a0"] = "a4"
    """Paper of the drawings."""

    screen: Settings = ()
    """For -o FILE.png, a screen as target: size_px=1920,1080 and diagonal_inch=24, or instead of
    the diagonal pitch_mm=0.27, from one of its pixels to the next."""

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
        from trinoc.calib.targets.abstract_target import AbstractTarget
        from trinoc.io.saving import expect_replaceable

        layout = self.out.with_suffix(".json")
        expect_replaceable(layout, AbstractTarget, force=self.force)
        self._expect_drawings(layout, (".png",) if kind == ".png" else (".svg", ".pdf"))
        screen = read_screen(self.screen, is_meant=kind == ".png")
        proposal = self._proposal(screen)
        sheet = self._board(proposal)
        written, notes = self._print(sheet) if screen is None else self._show(sheet, screen)
        if proposal is not None:
            said = (
                f"Circles are {proposal.circle_px:.0f} px wide, and the sheet takes "
                f"{proposal.field_share:.0%} of the shorter side."
            )
            notes = [said, *notes]
        text = f"{len(sheet)} {sheet.point_kind}, {sheet.name}\n" + "\n".join(notes)
        record = {"name": sheet.name, sheet.point_kind: len(sheet)}
        return Outcome(text, record, written=written)

    def _expect_drawings(self, layout: Path, kinds: Sequence[str]) -> None:
        """Raise InputError where a picture that no layout stands beside would be replaced."""
        for place in map(layout.with_suffix, kinds):
            if place.exists() and not layout.exists() and not self.force:
                raise InputError(
                    f"{place} is there, and no layout {layout.name} beside it, so that it may be "
                    "something else, which would be lost: give another name, or --force."
                )

    def _print(self, sheet: "AbstractBoard") -> tuple[list[Path], list[str]]:
        """Layout and drawings on paper: the files, and what to do with them."""
        from trinoc.io.board_json import save_target
        from trinoc.io.pattern_page import save_pattern_pdf, save_pattern_svg

        drawing, page = self.out.with_suffix(".svg"), self.out.with_suffix(".pdf")
        # First the drawing, which fails where the sheet is larger than the paper.
        save_pattern_svg(sheet, drawing, paper=self.paper)
        save_target(sheet, self.out)
        side = "tag" if sheet.kind == "aprilgrid" else "square"
        notes = [f"Print at 100 %, and give the side of a {side} as you measure it."]
        if sheet.kind == SHEET:
            notes = [
                "Print at 100 %, measure the two scale bars, and give measured over nominal length",
                "to `trinoc calibrate --print-scale`.",
            ]
        if importlib.util.find_spec("reportlab") is None:
            notes.append("No PDF, because reportlab is missing: pip install 'trinoc[print]'.")
            return [self.out, drawing], notes
        save_pattern_pdf(sheet, page, paper=self.paper)
        return [self.out, drawing, page], notes

    def _show(self, sheet: "AbstractBoard", screen: Screen) -> tuple[list[Path], list[str]]:
        """Picture for the screen and layout: the files, and what to do with them."""
        from trinoc.io.board_json import save_target
        from trinoc.io.pattern_page import drawing_size_mm
        from trinoc.io.pattern_png import save_pattern_png

        layout = self.out.with_suffix(".json")
        save_pattern_png(sheet, self.out, size_px=screen.size_px, pitch_mm=screen.pitch_mm)
        save_target(sheet, layout)
        width, height = drawing_size_mm(sheet)
        notes = [
            f"Pixels of {screen.pitch_mm:.4f} mm. Show it full screen at 100 %, with no scaling by "
            "the desktop or the viewer.",
            f"From outer edge to outer edge the ink is {width:.1f} x {height:.1f} mm: measure it "
            + (
                "and give measured\nover nominal length to `trinoc calibrate --print-scale`."
                if sheet.kind == SHEET
                else "on the screen."
            ),
        ]
        return [self.out, layout], notes

    def _proposal(self, screen: Screen | None) -> "SheetProposal | None":
        """The sizes of a sheet for the camera that --camera states. Raises UsageError."""
        said = read_settings("--camera", self.camera, CAMERA)
        if not said:
            return None
        if self._kind() != SHEET:
            raise UsageError(
                "--camera is of the sheet of circles: give square_mm or tag_mm behind the kind."
            )
        self._refuse("--camera chooses them", "rows", "columns")
        for word in self.layout:
            if word.startswith(_CHOSEN):
                raise UsageError(f"--camera chooses them: leave out {word}.")
        missing = [name for name in CAMERA if name not in said]
        if missing:
            raise UsageError(
                f"--camera lacks {' and '.join(missing)}: write --camera distance_mm=500 "
                "field_deg=30 size_px=1280,960."
            )
        distance_mm, angle, (width, height) = (said[name] for name in CAMERA)
        if distance_mm <= 0:
            raise UsageError(
                f"--camera distance_mm is {distance_mm:g}: give the distance from the camera to "
                "the sheet."
            )
        if not 0 < angle < 170:
            raise UsageError(
                f"--camera field_deg is {angle:g}: give an angle above 0 and below 170."
            )
        if min(width, height) <= 0:
            raise UsageError(
                f"--camera size_px is {width},{height}: give width and height of its pictures."
            )

        from trinoc.calib.targets.printing import propose_sheet
        from trinoc.io.pattern_page import drawing_room_mm
        from trinoc.io.pattern_png import screen_room_mm

        across = 2 * distance_mm * math.tan(math.radians(angle) / 2)
        return propose_sheet(
            field_mm=(across, across * height / width),
            size_px=(width, height),
            room_mm=(
                drawing_room_mm(self.paper)
                if screen is None
                else screen_room_mm(screen.size_px, screen.pitch_mm)
            ),
        )

    def _kind(self) -> str:
        """The kind, or the file of a layout: the word before those with a value."""
        names = [word for word in self.layout if "=" not in word]
        if len(names) > 1:
            raise UsageError(
                f"{names[0]} and {names[1]} are two kinds: give one, and what it has as NAME=VALUE."
            )
        return names[0] if names else SHEET

    def _refuse(self, why: str, *names: str) -> None:
        """Raise UsageError where one of these options is given."""
        for name in names:
            if getattr(self, name) is not None:
                raise UsageError(f"{why}: leave out --{name.replace('_', '-')}.")

    def _board(self, proposal: "SheetProposal | None") -> "AbstractBoard":
        from trinoc.calib.targets.abstract_target import AbstractBoard
        from trinoc.calib.targets.board_set import BOARDS
        from trinoc.calib.targets.checkers import Chessboard
        from trinoc.io.board_json import load_target

        kind, words = self._kind(), [word for word in self.layout if "=" in word]
        if kind.lower().endswith(".json"):
            self._refuse(f"{kind} says it already", "rows", "columns")
            if words:
                raise UsageError(f"{kind} says it already: leave out {words[0]}.")
            board = load_target(kind)
            if not isinstance(board, AbstractBoard):
                raise UsageError(f"{kind} holds several boards: give the layout of one of them.")
            return board
        if kind not in BOARDS:
            raise UsageError(
                f"{kind} is no kind of board: give {', '.join(BOARDS)}, or a layout, FILE.json."
            )
        for word in words:
            if word.startswith(("rows=", "columns=")):
                raise UsageError(f"{word} is an option of its own: write --{word}.")
        rows = _COUNT if self.rows is None else self.rows
        columns = _COUNT if self.columns is None else self.columns
        if kind == SHEET:
            return self._sheet(rows, columns, words, proposal)
        board = BOARDS[kind]
        types: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(board)}
        names = [name for name in board.layout.values() if name not in ("rows", "columns")]
        said = read_settings(kind, [words], {name: _PARSERS[types[name]] for name in names})
        usual = {name: value for name, value in _USUAL.items() if name in names}
        # A chessboard counts its inner corners.
        beyond = 1 if board is Chessboard else 0
        counts = {"rows": rows - beyond, "columns": columns - beyond}
        usual |= {name: value for name, value in counts.items() if name in board.layout.values()}
        return board(**{**usual, **said})

    def _sheet(
        self, rows: int, columns: int, words: list[str], proposal: "SheetProposal | None"
    ) -> "AbstractBoard":
        from trinoc.calib.targets.pattern import Pattern

        sizes: dict[str, Any] = {"rows": rows, "columns": columns, **_SHEET_SIZES}
        if proposal is not None:
            sizes = {
                "rows": proposal.count,
                "columns": proposal.count,
                "pitch_mm": proposal.pitch_mm,
                "radius_mm": proposal.radius_mm,
            }
        return Pattern.cross_grid(**{**sizes, **read_settings(SHEET, [words], _SHEET)})
