"""`trinoc view`: cameras and 3-D segments in a browser, to turn."""

import dataclasses
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from trinoc.cli.command import BoardFileOrNone, Command, FileOrNone, Outcome, UsageError
from trinoc.cli.views import read_rig

if TYPE_CHECKING:
    from trinoc.report.space_content import Ellipsoids
    from trinoc.report.space_part import SpaceFigure


Port = Annotated[
    Literal["open"] | int,
    tyro.conf.arg(metavar="N|open", help_behavior_hint="(default: a free one)"),
]


def read_port(port: str | int) -> int:
    """The number that is meant, 0 for a free one.

    Raises UsageError: a server's thread would fail by itself, and the command wait on.
    """
    if isinstance(port, str):
        return 0
    if not 0 <= port <= 65535:
        raise UsageError(f"--port is {port}: give one up to 65535, or leave it out for a free one.")
    return port


def show(url: str, browser: bool) -> None:
    """Say where to look, also to whom is `--quiet`: nothing else can be done without it."""
    print(f"trinoc: open {url} in a browser; Ctrl-C ends it", file=sys.stderr, flush=True)
    if browser:
        import webbrowser

        webbrowser.open(url)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ViewCommand(Command):
    """Turn cameras, sheet and 3-D segments in a browser, until Ctrl-C. Needs trinoc[view]."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """What to show: a rig.json, matches, a wire frame or other features."""

    rig: FileOrNone = None
    """The cameras to show beside matches, a wire frame or rims."""

    board: BoardFileOrNone = None
    """The sheet to show beside cameras."""

    port: Port = 0
    """Port on 127.0.0.1, which no other machine reaches; open: the browser shows it."""

    def run(self, command_line: str) -> Outcome:
        """Serve until interrupted."""
        port = read_port(self.port)
        from trinoc.errors import expect_extra

        expect_extra("viser", "view")
        figure, ellipsoids, said = self._content()

        from trinoc.serving.space import serve_space

        title = f"trinoc: {self.file.name}"
        with serve_space(figure, ellipsoids, title=title, port=port) as url:
            show(url, self.port == "open")
            wait_for_interruption()
        return Outcome(f"{said}, no longer shown.", {"shown": str(self.file), "url": url})

    def _content(self) -> "tuple[SpaceFigure, Ellipsoids | None, str]":
        from trinoc.geometry.features import Feature
        from trinoc.geometry.rig import Rig
        from trinoc.io.board_json import load_pattern
        from trinoc.io.saving import load
        from trinoc.match.tracks.matches import Matches
        from trinoc.match.wire_frame.frame import Wireframe
        from trinoc.report.features_part import features_figure
        from trinoc.report.space_content import error_ellipsoids
        from trinoc.report.space_part import SpaceFigure, space_figure

        value = load(self.file)
        if not isinstance(value, Rig | Matches | Feature):
            raise UsageError(
                f"{self.file} holds nothing that is shown here: give a rig.json, matches, a wire "
                "frame or other features."
            )
        pattern = None if self.board is None else load_pattern(self.board)
        if isinstance(value, Feature):
            if self.board is not None:
                raise UsageError("--board goes with cameras and matches: leave it out.")
            rig = None if self.rig is None else read_rig(self.rig)
            ellipsoids = None
            if isinstance(value, Wireframe):
                ellipsoids = error_ellipsoids(value.lines_mm, value.covariance_mm2)
            return features_figure(value, rig), ellipsoids, value.summary().rstrip(".")
        if isinstance(value, Rig):
            if self.rig is not None:
                raise UsageError(f"{self.file} is a rig itself: --rig goes with a matches.npz.")
            rig = read_rig(self.file)
            return space_figure(rig, pattern, None), None, f"{len(rig)} cameras"
        if self.rig is None:
            if self.board is not None:
                raise UsageError("--board goes with cameras: give --rig, too.")
            figure = SpaceFigure.of_tracks(value)
        else:
            figure = space_figure(read_rig(self.rig), pattern, value)
        return (
            figure,
            error_ellipsoids(value.lines_mm, value.covariance_mm2),
            f"{len(value)} tracks",
        )


def wait_for_interruption() -> None:
    """Until Ctrl-C, which is how a view ends."""
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        print(file=sys.stderr)
