"""`trinoc pattern`: a sheet or board to print, with the layout that other commands read."""

import dataclasses
import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import trinoc
from trinoc.cli.command import Job, Outcome, UsageError
from trinoc.cli.options import Settings
from trinoc.cli.settings import (
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

_MM_PER_INCH = 25.4
# Glasses for virtual reality have pixels of .01 mm, walls of diodes of 4 mm.
_PITCHES_MM = (0.005, 5.0)
_MOST_PX = 20_000

SHEET = "sheet"
_CAMERA = {
    "distance_mm": parse_number,
    "field_deg": parse_number,
    "size_px": parse_pair(parse_integer),
}
_SCREEN = {
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


def pattern(
    layout: tuple[str, ...] = (),
    /,
    *,
    rows: int | None = None,
    columns: int | None = None,
    camera: Settings = (),
    paper: Literal["a4", "letter", "a3", "a2", "a1", "a0"] = "a4",
    screen: Settings = (),
    out: Path = Path("pattern.json"),
    job: Job,
) -> Outcome:
    """Create a sheet of circles and crossed lines, or a board: its layout, and drawings to print.

    Parameters
    ----------
    layout : KIND|LAYOUT.json NAME=VALUE (default: sheet)
        Kind of target: sheet for `trinoc calibrate`; chessboard, charuco or aprilgrid for
        `calibrate-rig`; or an existing layout (JSON). Settings follow the kind. sheet: pitch_mm=20
        (between the centres of neighbouring circles) radius_mm=6 line_style=stop|through|white (at
        a circle, a line of an odd grid stops, or crosses the circle in black or in white).
        chessboard: square_mm=20. charuco: square_mm=20 marker_mm=15 dictionary=4x4_250 first=0
        legacy=no inverted=no (black and white exchanged) mirrored=no (mirror image, for the back of
        a two-sided board). aprilgrid: tag_mm=16 spacing=0.3 (gap over tag size)
        dictionary=APRILTAG_36h11 first=0 border=2. first is the id of the first marker; boards that
        are fixed to each other need different ids.
    rows : N (default: 8)
        Number of circles from top to bottom; an even number, so that no line meets a circle. For a
        board: number of squares or tags.
    columns : N (default: 8)
        Number of circles from left to right; also even. For a board: number of squares or tags.
    camera
        Choose number, pitch and radius of the circles for this camera: distance_mm=500 (camera to
        sheet), field_deg=30 (horizontal field of view: 2 atan(w / 2f) for focal length f and sensor
        width w), size_px=1280,960 (image size).
    paper
        Paper size of the drawings.
    screen
        With -o FILE.png: the screen that shows the target, size_px=1920,1080 and diagonal_inch=24;
        or pitch_mm=0.27, the distance between its pixels, in place of the diagonal.
    out
        File of the layout (.json). The drawings (.svg, .pdf) are written beside it. With .png:
        image for a screen, with its layout beside it.
    """
    ending = out.suffix.lower()
    if ending not in (".json", ".png"):
        raise UsageError(
            f"{out}: a layout is JSON: choose a name that ends in .json, or in .png for a screen "
            "as target."
        )
    from trinoc.calib.targets.abstract_target import AbstractTarget

    file = out.with_suffix(".json")
    job.expect(AbstractTarget, file)
    drawings = (".png",) if ending == ".png" else (".svg", ".pdf")
    _expect_drawings(file, drawings, force=job.force)
    display = _read_screen(screen, is_meant=ending == ".png")
    kind, settings = _split_layout(layout)
    camera_values = read_settings("--camera", camera, _CAMERA)
    proposal = None
    if camera_values:
        _expect_free_sizes(kind, settings, rows, columns)
        proposal = _propose_sheet(camera_values, display, paper)
    board = _make_board(kind, settings, rows, columns, proposal)
    if display is None:
        written, notes = _print(board, out, paper)
    else:
        written, notes = _show(board, out, display)
    if proposal is not None:
        notes.insert(
            0,
            f"Circles are {proposal.circle_px:.0f} px wide, and the sheet takes "
            f"{proposal.field_share:.0%} of the shorter side.",
        )
    text = "\n".join([f"{len(board)} {board.point_kind}, {board.name}", *notes])
    return Outcome(text, {"name": board.name, board.point_kind: len(board)}, written=written)


class Screen(NamedTuple):
    """Screen that displays a target: width and height in px, and pixel pitch in mm."""

    size_px: tuple[int, int]
    pitch_mm: float


def _read_screen(arguments: tuple[tuple[str, ...], ...], *, is_meant: bool) -> Screen | None:
    """Screen of the option --screen; None if no screen is wanted. Raises UsageError.

    is_meant : True if the output is an image for a screen.
    """
    values = read_settings("--screen", arguments, _SCREEN)
    if not is_meant:
        if values:
            raise UsageError("--screen needs an image file as output: give -o FILE.png, too.")
        return None
    size_px = values.get("size_px", (0, 0))
    if not all(0 < side <= _MOST_PX for side in size_px):
        raise UsageError(
            "A PNG is made for one screen: give its width and height, such as --screen "
            "size_px=1920,1080 diagonal_inch=24."
        )
    if ("diagonal_inch" in values) == ("pitch_mm" in values):
        raise UsageError(
            "The size of the pixels of the screen needs exactly one setting: give --screen "
            "diagonal_inch=INCH, such as 24, or --screen pitch_mm=MM, such as 0.27."
        )
    pitch_mm = values.get("pitch_mm")
    if pitch_mm is None:
        pitch_mm = values["diagonal_inch"] * _MM_PER_INCH / math.hypot(*size_px)
    smallest_mm, largest_mm = _PITCHES_MM
    if not smallest_mm <= pitch_mm <= largest_mm:
        raise UsageError(
            f"Pixels of {pitch_mm:g} mm are on no screen: the diagonal is in inches, the pitch in "
            "millimetres."
        )
    return Screen(size_px, pitch_mm)


def _expect_drawings(layout: Path, endings: Sequence[str], *, force: bool) -> None:
    """Raise InputError if a drawing would replace an image file that has no layout of the same
    name.
    """
    for drawing in map(layout.with_suffix, endings):
        if drawing.exists() and not layout.exists() and not force:
            raise InputError(
                f"{drawing} exists without its layout {layout.name}, so it may be another file, "
                "which would be overwritten: give another name, or --force."
            )


def _split_layout(arguments: tuple[str, ...]) -> tuple[str, list[str]]:
    """Return the kind of board or the layout file, and the settings NAME=VALUE."""
    names = [word for word in arguments if "=" not in word]
    if len(names) > 1:
        raise UsageError(
            f"{names[0]} and {names[1]} are two kinds of boards: give one kind, and its settings "
            "as NAME=VALUE."
        )
    return names[0] if names else SHEET, [word for word in arguments if "=" in word]


def _expect_no_counts(why: str, rows: int | None, columns: int | None) -> None:
    for name, count in (("rows", rows), ("columns", columns)):
        if count is not None:
            raise UsageError(f"{why}: leave out --{name}.")


def _expect_free_sizes(
    kind: str, settings: list[str], rows: int | None, columns: int | None
) -> None:
    """Raise UsageError if sizes are given in addition to --camera, which determines them."""
    if kind != SHEET:
        raise UsageError(
            "--camera is an option for the sheet of circles only: for this kind of board, give "
            "square_mm or tag_mm after the kind."
        )
    _expect_no_counts("--camera chooses them", rows, columns)
    for word in settings:
        if word.partition("=")[0] in _SHEET_SIZES:
            raise UsageError(f"--camera determines these sizes: omit {word}.")


def _propose_sheet(camera: dict[str, Any], screen: Screen | None, paper: Any) -> "SheetProposal":
    """Sheet that suits the camera of the option --camera. Raises UsageError."""
    missing = [name for name in _CAMERA if name not in camera]
    if missing:
        raise UsageError(
            f"--camera lacks {' and '.join(missing)}: write --camera distance_mm=500 field_deg=30 "
            "size_px=1280,960."
        )
    distance_mm, angle, (width, height) = (camera[name] for name in _CAMERA)
    if distance_mm <= 0:
        raise UsageError(
            f"--camera distance_mm is {distance_mm:g}: give the distance from the camera to the "
            "sheet."
        )
    if not 0 < angle < 170:
        raise UsageError(f"--camera field_deg is {angle:g}: give an angle above 0 and below 170.")
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
        room_mm=drawing_room_mm(paper) if screen is None else screen_room_mm(*screen),
    )


def _make_board(
    kind: str,
    settings: list[str],
    rows: int | None,
    columns: int | None,
    proposal: "SheetProposal | None",
) -> "AbstractBoard":
    """Board of a kind, or of a layout file.

    settings : NAME=VALUE. proposal : sizes that suit the camera of --camera; None without the
        option.
    """
    from trinoc.calib.targets.board_set import BOARDS
    from trinoc.calib.targets.checkers import Chessboard

    if kind.lower().endswith(".json"):
        _expect_no_counts(f"{kind} already states the rows and columns", rows, columns)
        if settings:
            raise UsageError(f"{kind} already states this: omit {settings[0]}.")
        return _read_board(kind)
    if kind not in BOARDS:
        raise UsageError(
            f"{kind} is no kind of board: give {', '.join(BOARDS)}, or a layout, FILE.json."
        )
    for word in settings:
        if word.startswith(("rows=", "columns=")):
            raise UsageError(f"{word} is a separate option: write --{word}.")
    counts = {
        "rows": _COUNT if rows is None else rows,
        "columns": _COUNT if columns is None else columns,
    }
    if kind == SHEET:
        sizes: dict[str, Any] = {**counts, **_SHEET_SIZES}
        if proposal is not None:
            sizes = {
                "rows": proposal.count,
                "columns": proposal.count,
                "pitch_mm": proposal.pitch_mm,
                "radius_mm": proposal.radius_mm,
            }
        return trinoc.Pattern.cross_grid(**{**sizes, **read_settings(SHEET, [settings], _SHEET)})
    board = BOARDS[kind]
    fields = board.layout.values()
    types: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(board)}
    parsers = {name: _PARSERS[types[name]] for name in fields if name not in counts}
    # A chessboard counts its inner corners.
    beyond = 1 if board is Chessboard else 0
    usual = {**_USUAL, **{name: count - beyond for name, count in counts.items()}}
    usual = {name: value for name, value in usual.items() if name in fields}
    return board(**{**usual, **read_settings(kind, [settings], parsers)})


def _read_board(file: str) -> "AbstractBoard":
    from trinoc.calib.targets.abstract_target import AbstractBoard

    board = trinoc.io.load_target(file)
    if not isinstance(board, AbstractBoard):
        raise UsageError(f"{file} holds several boards: give the layout of one of them.")
    return board


def _print(board: "AbstractBoard", out: Path, paper: Any) -> tuple[list[Path], list[str]]:
    """Write layout and drawings for printing. Return the files, and instructions for the user."""
    from trinoc.io.board_json import save_target

    drawing, page = out.with_suffix(".svg"), out.with_suffix(".pdf")
    # First the drawing, which fails where the sheet is larger than the paper.
    trinoc.io.save_pattern_svg(board, drawing, paper=paper)
    save_target(board, out)
    side = "tag" if board.kind == "aprilgrid" else "square"
    notes = [f"Print at 100 %, and give the side of a {side} as you measure it."]
    if board.kind == SHEET:
        notes = [
            "Print at 100 %, measure the two scale bars, and give measured over nominal length",
            "to `trinoc calibrate --print-scale`.",
        ]
    if importlib.util.find_spec("reportlab") is None:
        notes.append("No PDF, because reportlab is missing: pip install 'trinoc[print]'.")
        return [out, drawing], notes
    trinoc.io.save_pattern_pdf(board, page, paper=paper)
    return [out, drawing, page], notes


def _show(board: "AbstractBoard", out: Path, screen: Screen) -> tuple[list[Path], list[str]]:
    """Write the image for a screen and the layout. Return files, and instructions for the user."""
    from trinoc.io.board_json import save_target
    from trinoc.io.pattern_page import drawing_size_mm

    layout = out.with_suffix(".json")
    trinoc.io.save_pattern_png(board, out, size_px=screen.size_px, pitch_mm=screen.pitch_mm)
    save_target(board, layout)
    width, height = drawing_size_mm(board)
    use = "on the screen."
    if board.kind == SHEET:
        use = "and give measured\nover nominal length to `trinoc calibrate --print-scale`."
    notes = [
        f"Pixels of {screen.pitch_mm:.4f} mm. Show it full screen at 100 %, with no scaling by "
        "the desktop or the viewer.",
        f"From outer edge to outer edge the ink is {width:.1f} x {height:.1f} mm: measure it {use}",
    ]
    return [out, layout], notes
