"""`trinoc watch`: pictures of a board judged as they arrive."""

import contextlib
import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from trinoc.cli.arrivals import FolderArrivals, camera_frames
from trinoc.cli.command import Command, Outcome, UsageError
from trinoc.cli.progress import LOGGER
from trinoc.cli.serving_options import Port, expect_port, show
from trinoc.cli.watch_session import WatchSession
from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.capture import Judgement


@dataclasses.dataclass(frozen=True, kw_only=True)
class Watch(Command):
    """Judge pictures of a board as they arrive, and say what to show next, until Ctrl-C."""

    source: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="FOLDER|CAMERA")]
    """The folder that pictures of one camera arrive in, or the number of a camera of this machine,
    such as 0."""

    pattern: Path
    """Layout of the sheet or board (JSON), as `trinoc pattern` writes it."""

    every_s: float = 1.0
    """Look so often."""

    keep: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: none)")
    ] = None
    """Of a camera: write good pictures that show something new here, as PNG."""

    once: bool = False
    """Judge the pictures that are there, and end."""

    no_page: bool = False
    """Serve no page: say everything in the terminal alone."""

    port: Port = 0
    """Of the page, on this machine's own address, 127.0.0.1, which no other machine reaches."""

    open: bool = False
    """Open the browser."""

    def run(self, command_line: str) -> Outcome:
        """Watch until interrupted."""
        if not 0 < self.every_s <= 3600:
            raise UsageError(f"--every-s is {self.every_s:g}: give seconds, such as 1.")
        expect_port(self.port)
        number = int(self.source) if self.source.isdecimal() else None
        if number is None and self.keep is not None:
            raise UsageError("--keep goes with a camera: the pictures of a folder are kept there.")
        if number is not None and self.once:
            raise UsageError("--once goes with a folder: a camera has always one more picture.")

        from trinoc.calib import BoardSet
        from trinoc.io import load_target

        # Before the page is shown: a folder that is none ends the command.
        source = FolderArrivals(Path(self.source)) if number is None else number
        target = load_target(self.pattern)
        if isinstance(target, BoardSet):
            raise UsageError(
                f"{self.pattern} holds several boards, and one is watched at a time: give the "
                "layout of one of them."
            )
        session = WatchSession(target, self.source, self.json, self.quiet)
        with contextlib.ExitStack() as stack:
            if not self.no_page and not self.once:
                show(stack.enter_context(_page(session, self.port)), self.open)
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

        from trinoc.io import read_image

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

        from trinoc.capture import shows_something_new
        from trinoc.io import atomic_write

        if shows_something_new(session.judgements[:-1], judgement):
            self.keep.mkdir(parents=True, exist_ok=True)
            numbers = (path.stem.removeprefix("shot_") for path in self.keep.glob("shot_*.png"))
            taken = max((int(number) for number in numbers if number.isdecimal()), default=0)
            place = self.keep / f"shot_{taken + 1:04d}.png"
            with atomic_write(place) as file:
                file.write(cv2.imencode(".png", image)[1].tobytes())
            session.written.append(str(place))
            LOGGER.info("kept %s", place)


@contextlib.contextmanager
def _page(session: WatchSession, port: int) -> Iterator[str]:
    """The address of a page that shows how the session stands."""
    from trinoc.serving import picture_page, serve_pages, watch_page

    pages = {
        "/": lambda: watch_page(session.watched),
        "/last.jpg": lambda: picture_page(session.watched),
    }
    with serve_pages(pages, port=port) as url:
        yield url
