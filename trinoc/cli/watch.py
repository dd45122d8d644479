"""`trinoc watch`: pictures of a board judged as they arrive, and the rig that comes of them."""

import contextlib
import dataclasses
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from trinoc.cli.calibrate_rig import CalibrateRigCommand
from trinoc.cli.command import (
    LOGGER,
    BoardFile,
    Command,
    FileOrNone,
    Interruption,
    Outcome,
    ReportOption,
    UsageError,
)
from trinoc.cli.intrinsics import IntrinsicsCommand
from trinoc.cli.views import files_of_views
from trinoc.errors import InputError, TrinocError

if TYPE_CHECKING:
    from trinoc.calib.targets.abstract_target import AbstractTarget
    from trinoc.serving.kept_shots import KeptShots
    from trinoc.serving.session import WatchSession
    from trinoc.serving.sources import Moment


@dataclasses.dataclass(frozen=True, kw_only=True)
class WatchCommand(ReportOption, Command):
    """Judge pictures of a board as they arrive, say what to show next, and calibrate with them."""

    sources: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="[NAME=]FOLDER|CAMERA|VIDEO", help_behavior_hint="(required)"),
    ]
    """A folder that pictures arrive in, or the number of a camera, such as 0, until Ctrl-C; or a
    video. Of several cameras each with its name: left=0 right=1."""

    board: BoardFile
    """Layout of the sheet or board (JSON), as `trinoc pattern` writes it."""

    every_s: float = 1.0
    """Look so often, at the sharpest moment since."""

    keep: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: beside the rig)"),
    ] = None
    """Keep shots that are good and new here, as PNG; those that are there count."""

    out: Annotated[FileOrNone, tyro.conf.arg(aliases=("-o",))] = None
    """Calibrate with what was kept, and write the rig here; of one camera without a name its
    lens."""

    once: bool = False
    """Judge the pictures that are there, and end."""

    port: Annotated[
        Literal["none", "open"] | int,
        tyro.conf.arg(metavar="N|open|none", help_behavior_hint="(default: a free one)"),
    ] = 0
    """Of the page, on 127.0.0.1, which no other machine reaches; open: the browser shows it; none:
    no page."""

    def run(self, command_line: str) -> Outcome:
        """Watch until interrupted or to the end, and calibrate where a rig is asked for."""
        if not 0 < self.every_s <= 3600:
            raise UsageError(f"--every-s is {self.every_s:g}: give seconds, such as 1.")
        port = None if self.port == "none" else _read_port(self.port)
        if self.report is not None and self.out is None:
            raise UsageError("--report is of a calibration: say by -o where the rig goes.")
        places = self._places()
        kind = self._kind(places)
        target = self._target()
        self._expect_results("" in places)
        from trinoc.serving.sources import open_source

        # Before the page is shown: what is no source ends the command.
        moments = open_source(places, self.every_s, once=self.once, warn=LOGGER.warning)
        kept = self._open_kept(places, kind)

        from trinoc.serving.session import WatchSession

        stream = sys.stderr if self.json else sys.stdout
        is_silent = self.json and self.quiet

        def say(line: str) -> None:
            if not is_silent:
                print(line, file=stream, flush=True)

        session = WatchSession(target, " ".join(self.sources), tuple(places), kept, say)
        with contextlib.ExitStack() as stack:
            if port is not None and not self.once:
                _show(stack.enter_context(session.serve(port)), self.port == "open")
            self._watch(session, moments)
            return self._finish(session, command_line)

    def _places(self) -> dict[str, str]:
        """The source of each camera; of one without a name under ""."""
        if not self.sources:
            raise UsageError("No source is given: give a folder, a camera's number, or a video.")
        if len(self.sources) == 1 and "=" not in self.sources[0]:
            return {"": self.sources[0]}
        return {name: str(place) for name, place in files_of_views(self.sources).items()}

    def _kind(self, places: Mapping[str, str]) -> str:
        """ "camera", "video" or "folder"; raises UsageError for options that do not go with it."""
        from trinoc.serving.sources import find_kind

        kinds = {find_kind(place) for place in places.values()}
        if len(kinds) > 1:
            for place in places.values():
                if not (place.isdecimal() or Path(place).exists()):
                    raise UsageError(f"{place} does not exist: check the name.")
            raise UsageError("Cameras, folders and videos do not go together: give one kind.")
        if len({int(p) if p.isdecimal() else Path(p) for p in places.values()}) < len(places):
            raise UsageError("Two cameras are given one source: give each its own.")
        (kind,) = kinds
        if self.once and kind != "folder":
            raise UsageError(
                "--once goes with a folder: a camera has always one more picture, and a video ends "
                "by itself."
            )
        if self.keep is not None and kind == "folder" and "" in places:
            raise UsageError("--keep goes with a camera: the pictures of a folder are kept there.")
        return kind

    def _target(self) -> "AbstractTarget":
        from trinoc.calib.targets.board_set import BoardSet
        from trinoc.io.board_json import load_target

        target = load_target(self.board)
        if isinstance(target, BoardSet):
            raise UsageError(
                f"{self.board} holds several boards, and one is watched at a time: give the "
                "layout of one of them."
            )
        return target

    def _expect_results(self, is_lens: bool) -> None:
        """Before anything is watched, that what is to come of it can be written."""
        if self.out is None:
            return

        from trinoc.geometry.intrinsics import Intrinsics
        from trinoc.geometry.rig import Rig
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable

        if is_lens and self.report is not None:
            raise UsageError(
                "Of a camera without a name comes a lens, which has no report: name it, such as "
                f"camera={self.sources[0]}, and a rig of one comes."
            )
        expect_place(self.out, self.report)
        expect_replaceable(self.out, Intrinsics if is_lens else Rig, force=self.force)

    def _open_kept(self, places: Mapping[str, str], kind: str) -> "KeptShots | None":
        """Where shots are kept: where that is said, or beside the result."""
        from trinoc.serving.kept_shots import KeptShots

        if self.keep is not None:
            kept = KeptShots(self.keep, tuple(places))
            watched = {Path(place).resolve() for place in places.values()}
            if watched & {place.resolve() for place in kept.folders.values()}:
                raise UsageError(
                    f"--keep {self.keep} would write into a folder that is watched: give another."
                )
            return kept
        if self.out is None or (kind == "folder" and "" in places):
            return None
        kept = KeptShots(self.out.with_name(f"{self.out.stem}_shots"), tuple(places))
        if kept.names():
            raise UsageError(
                f"{kept.folder} holds {len(kept.names())} shots of an earlier run: go on with them "
                f"by --keep {shlex.quote(str(kept.folder))}, or give another folder."
            )
        return kept

    def _watch(self, session: "WatchSession", moments: "Iterator[Moment]") -> None:
        try:
            if session.kept is not None:
                for moment in session.kept.read():
                    session.look(moment, is_kept=True)
            for moment in moments:
                session.look(moment)
        except KeyboardInterrupt:
            print(file=sys.stderr)
        except InputError as error:
            # What was kept is not lost by a cable that was pulled.
            if self.out is None or not session.shots:
                raise
            LOGGER.warning("%s", error)

    def _finish(self, session: "WatchSession", command_line: str) -> Outcome:
        """The summary, and the calibration where `--out` names its file."""
        from trinoc.capture.shots import find_missing

        written = [] if session.kept is None else session.kept.written
        outcome = Outcome(session.summarise(), session.record(), written=written)
        if self.out is None:
            return outcome
        missing = find_missing(session.informative_shots, session.cameras)
        if missing is not None:
            return self._refuse(session, outcome, missing, command_line)
        LOGGER.info("calibrating with %d shots", len(session.informative_shots))
        session.announce("Calibrating with what was kept ...")
        try:
            found = self._calibrate(session, command_line)
        except TrinocError as error:
            return self._refuse(session, outcome, str(error), command_line)
        except KeyboardInterrupt:
            raise Interruption(f"Interrupted: {self._way_on(session, command_line)}") from None
        session.wait_for_reader()
        return Outcome(
            f"{outcome.text}\n{found.text}",
            {**outcome.record, "calibration": found.record},
            refusal=found.refusal,
            written=[*written, *(found.written or ())],
        )

    def _calibrate(self, session: "WatchSession", command_line: str) -> Outcome:
        """What `intrinsics` or `calibrate-rig` makes of the shots."""
        shared: Any = {"out": self.out, "quiet": self.quiet, "force": self.force}
        if not session.is_named:
            if session.kept is not None:
                folder, names = session.kept.folder, [f"{n}.png" for n in session.kept.names()]
            else:
                folder, names = (
                    Path(self.sources[0]),
                    [s.name for s in session.shots if s.good_cameras],
                )
            images = tuple(folder / name for name in names)
            command = IntrinsicsCommand(images=images, board=(self.board,), **shared)
            found = command.run(command_line)
            session.announce("The lens is calibrated.", [f"written: {self.out}"], is_last=True)
            return found

        import numpy as np

        from trinoc.report.checks import Level
        from trinoc.report.html import judge_shots

        assert session.kept is not None
        shots = tuple(f"{name}={place}" for name, place in session.kept.folders.items())
        command = CalibrateRigCommand(
            shots=shots, board=(self.board,), report=self.report, **shared
        )
        result, found = command.calibrate(command_line)
        verdict, advice = judge_shots(result), found.record["next_shot"]
        if advice is not None and result.has_rig:
            session.draw_next_shot(
                result.rig, advice["cameras"], np.array(advice["world_from_board"])
            )
        if verdict is not None:
            files = ", ".join(str(path) for path in (self.out, self.report) if path is not None)
            details = [verdict.reason, f"written: {files}"]
            details += [] if advice is None else [advice["sentence"]]
            tones: Any = {Level.GOOD: "good", Level.BAD: "bad"}
            session.announce(
                verdict.sentence, details, tone=tones.get(verdict.level, "plain"), is_last=True
            )
            found = found._replace(text=f"{found.text}\n{verdict.sentence} {verdict.reason}")
        return found

    def _refuse(
        self, session: "WatchSession", outcome: Outcome, why: str, command_line: str
    ) -> Outcome:
        session.announce(why, tone="bad", is_last=True)
        session.wait_for_reader()
        return outcome._replace(refusal=f"{why} {self._way_on(session, command_line)}")

    def _way_on(self, session: "WatchSession", command_line: str) -> str:
        """Where the shots are, and what to type to go on with them."""
        if session.kept is None:
            return f"The pictures are where they were; go on by: {command_line}"
        folder = shlex.quote(str(session.kept.folder))
        more = "" if self.keep is not None else f" --keep {folder}"
        return f"The shots are kept in {folder}; go on by: {command_line}{more}"


def _read_port(port: str | int) -> int:
    """Return the port number, 0 for a free one.

    Raises UsageError here, because an error in the server's thread would leave the command waiting.
    """
    if isinstance(port, str):
        return 0
    if not 0 <= port <= 65535:
        raise UsageError(f"--port is {port}: give one up to 65535, or leave it out for a free one.")
    return port


def _show(url: str, browser: bool) -> None:
    """Print the page's address on stderr, also with `--quiet`: nothing else can be done without."""
    print(f"trinoc: open {url} in a browser; Ctrl-C ends it", file=sys.stderr, flush=True)
    if browser:
        import webbrowser

        webbrowser.open(url)
