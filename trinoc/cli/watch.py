"""`trinoc watch`: pictures of a board judged as they arrive."""

import contextlib
import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.command import LOGGER, BoardFile, Command, Outcome, UsageError
from trinoc.cli.view import expect_port, show
from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.calib.targets.abstract_target import AbstractTarget
    from trinoc.capture.judgement import Judgement


class WatchSession:
    """What was judged so far, and how it is said."""

    def __init__(self, target: "AbstractTarget", source: str, json: bool, quiet: bool) -> None:
        from trinoc.serving.watching import WatchState

        self._target, self._stream = target, sys.stderr if json else sys.stdout
        self._silent = json and quiet
        self.judgements: list[Judgement] = []
        self.written: list[Path] = []
        self.watched: WatchState = WatchState(f"trinoc watch {source}")

    def look(self, name: str, image: "np.ndarray | InputError") -> "Judgement":
        """Judge a picture, and say so."""
        from trinoc.capture.advice import next_step
        from trinoc.capture.judgement import judge, judge_unread, judgement_line
        from trinoc.serving.watching import thumbnail

        try:
            if isinstance(image, InputError):
                raise image
            judgement = judge(name, image, self._target)
            small = thumbnail(image, judgement)
        except InputError as error:
            judgement, small = judge_unread(name, self._target, str(error)), b""
        # A picture that is written again takes the place of its former self.
        self.judgements = [j for j in self.judgements if j.name != name] + [judgement]
        self.watched = self.watched._replace(judgements=tuple(self.judgements), thumbnail=small)
        if not self._silent:
            advice = f"\n  {next_step(self.judgements)}" if judgement.good else ""
            print(judgement_line(judgement) + advice, file=self._stream, flush=True)
        return judgement

    def outcome(self) -> Outcome:
        """The summary."""
        from trinoc.capture.advice import field_share, next_step, summary_lines

        lines = summary_lines(self.judgements)
        record: dict[str, Any] = {
            "pictures": [_record(judgement) for judgement in self.judgements],
            "field": field_share(self.judgements),
            "next": next_step(self.judgements),
        }
        return Outcome("\n".join(lines), record, written=self.written)


def _record(judgement: "Judgement") -> dict[str, Any]:
    return {
        "name": judgement.name,
        "good": judgement.good,
        "found": len(judgement.places_px),
        "of": judgement.of_places,
        "refusal": judgement.refusal,
        "faults": list(judgement.faults),
        "edges_px": _none_if_nan(judgement.blur_px),
        "saturated": _none_if_nan(judgement.exposure.saturated),
        "dark": _none_if_nan(judgement.exposure.dark),
        "lean": list(judgement.lean),
    }


def _none_if_nan(value: float) -> float | None:
    return value if value == value else None


# Scans after which a picture without its end mark is taken as it is.
PATIENCE = 10


class FolderArrivals:
    """Pictures of a folder, each once it is written to its end, and again when it is replaced."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder} is no folder: give the one that pictures arrive in.")
        self._folder = folder
        self._seen: dict[Path, tuple[tuple[int, int], int]] = {}
        self._told: dict[Path, tuple[int, int]] = {}

    def ready(self, *, at_once: bool = False) -> list[Path]:
        """Pictures not told yet that did not change since the last call, the oldest first.

        at_once : also those seen for the first time.
        """
        from trinoc.io.images import IMAGE_SUFFIXES, is_whole_picture

        found = []
        for path in self._folder.iterdir():
            if path.suffix.lower() not in IMAGE_SUFFIXES:
                continue
            with contextlib.suppress(OSError):  # gone again, or not yet to be read
                status = path.stat()
                signature = status.st_size, status.st_mtime_ns
                before, scans = self._seen.get(path, (None, 0))
                scans = scans + 1 if before == signature else 0
                self._seen[path] = signature, scans
                if self._told.get(path) == signature or not (scans or at_once):
                    continue
                if at_once or scans >= PATIENCE or is_whole_picture(path):
                    found.append((status.st_mtime_ns, path))
                    self._told[path] = signature
        return [path for _, path in sorted(found)]


def camera_frames(number: int, every_s: float) -> "Iterator[np.ndarray]":
    """The newest frame of a camera, every so many seconds. Raises InputError."""
    import cv2

    camera: Any = cv2.VideoCapture(number)
    try:
        if not camera.isOpened():
            raise InputError(f"Camera {number} does not open: see that nobody else uses it.")
        while True:
            # A camera keeps frames waiting: all are taken, and the last is looked at.
            until = time.monotonic() + every_s
            there = camera.grab()
            while there and time.monotonic() < until:
                there = camera.grab()
            there, frame = camera.retrieve() if there else (False, None)
            if frame is None:
                raise InputError(f"Camera {number} sends no picture any more: look at its cable.")
            yield frame
    finally:
        camera.release()


@dataclasses.dataclass(frozen=True, kw_only=True)
class WatchCommand(Command):
    """Judge pictures of a board as they arrive, and say what to show next, until Ctrl-C."""

    source: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="FOLDER|CAMERA")]
    """The folder that pictures of one camera arrive in, or the number of a camera of this machine,
    such as 0."""

    board: BoardFile
    """Layout of the sheet or board (JSON), as `trinoc pattern` writes it."""

    every_s: float = 1.0
    """Look so often."""

    keep: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: none)")
    ] = None
    """Of a camera: write good pictures that show something new here, as PNG."""

    once: bool = False
    """Judge the pictures that are there, and end."""

    port: Annotated[
        Literal["none"] | int,
        tyro.conf.arg(metavar="N|none", help_behavior_hint="(default: a free one)"),
    ] = 0
    """Of the page, on this machine's own address, 127.0.0.1, which no other machine reaches; none
    for no page, so that everything is said in the terminal alone."""

    open: bool = False
    """Open the browser."""

    def run(self, command_line: str) -> Outcome:
        """Watch until interrupted."""
        if not 0 < self.every_s <= 3600:
            raise UsageError(f"--every-s is {self.every_s:g}: give seconds, such as 1.")
        port = None if self.port == "none" else self.port
        if port is not None:
            expect_port(port)
        number = int(self.source) if self.source.isdecimal() else None
        if number is None and self.keep is not None:
            raise UsageError("--keep goes with a camera: the pictures of a folder are kept there.")
        if number is not None and self.once:
            raise UsageError("--once goes with a folder: a camera has always one more picture.")

        from trinoc.calib.targets.board_set import BoardSet
        from trinoc.io.board_json import load_target

        # Before the page is shown: a folder that is none ends the command.
        source = FolderArrivals(Path(self.source)) if number is None else number
        target = load_target(self.board)
        if isinstance(target, BoardSet):
            raise UsageError(
                f"{self.board} holds several boards, and one is watched at a time: give the "
                "layout of one of them."
            )
        session = WatchSession(target, self.source, self.json, self.quiet)
        with contextlib.ExitStack() as stack:
            if port is not None and not self.once:
                show(stack.enter_context(_page(session, port)), self.open)
            try:
                for name, image in self._pictures(source):
                    self._keep(session, session.look(name, image), image)
            except KeyboardInterrupt:
                print(file=sys.stderr)
        return session.outcome()

    def _pictures(
        self, source: int | FolderArrivals
    ) -> "Iterator[tuple[str, np.ndarray | InputError]]":
        """Names and pictures of a camera or a folder, or why one is none."""
        if isinstance(source, int):
            for count, frame in enumerate(camera_frames(source, self.every_s), 1):
                yield f"picture {count}", frame
            return

        from trinoc.io.images import read_image

        while True:
            for path in source.ready(at_once=self.once):
                try:
                    image = read_image(path)
                except (InputError, OSError) as error:
                    yield path.name, InputError(str(error))
                else:
                    yield path.name, image
            if self.once:
                return
            time.sleep(self.every_s)

    def _keep(
        self, session: WatchSession, judgement: "Judgement", image: "np.ndarray | InputError"
    ) -> None:
        if self.keep is None or isinstance(image, InputError):
            return

        import cv2

        from trinoc.capture.advice import shows_something_new
        from trinoc.io.atomic import atomic_write

        if shows_something_new(session.judgements[:-1], judgement):
            self.keep.mkdir(parents=True, exist_ok=True)
            numbers = (path.stem.removeprefix("shot_") for path in self.keep.glob("shot_*.png"))
            taken = max((int(number) for number in numbers if number.isdecimal()), default=0)
            place = self.keep / f"shot_{taken + 1:04d}.png"
            with atomic_write(place) as file:
                file.write(cv2.imencode(".png", image)[1].tobytes())
            session.written.append(place)
            LOGGER.info("kept %s", place)


@contextlib.contextmanager
def _page(session: WatchSession, port: int) -> Iterator[str]:
    """The address of a page that shows how the session stands."""
    from trinoc.serving.pages import serve_pages
    from trinoc.serving.watching import picture_page, watch_page

    pages = {
        "/": lambda: watch_page(session.watched),
        "/last.jpg": lambda: picture_page(session.watched),
    }
    with serve_pages(pages, port=port) as url:
        yield url
