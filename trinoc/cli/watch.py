"""`trinoc watch`: pictures of a board judged as they arrive, and the rig that comes of them."""

import contextlib
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import trinoc
from trinoc.cli.calibrate_rig import calibrate_shots
from trinoc.cli.command import LOGGER, Interruption, Job, Outcome, UsageError
from trinoc.cli.intrinsics import intrinsics
from trinoc.cli.views import files_of_views
from trinoc.errors import InputError, TrinocError

if TYPE_CHECKING:
    from trinoc.calib.targets.abstract_target import AbstractTarget
    from trinoc.serving.kept_shots import KeptShots
    from trinoc.serving.session import WatchSession
    from trinoc.serving.sources import Moment


def watch(
    sources: tuple[str, ...],
    /,
    *,
    board: Path,
    every_s: float = 1.0,
    keep: Path | None = None,
    report: Path | None = None,
    out: Path | None = None,
    once: bool = False,
    port: Literal["none", "open"] | int = 0,
    job: Job,
) -> Outcome:
    """Check images of a board as they arrive, advise on the next pose, and calibrate.

    Parameters
    ----------
    sources : [NAME=]FOLDER|CAMERA|VIDEO
        A folder of arriving images or a camera id such as 0, both until Ctrl-C; or a video. For
        several cameras with names: left=0 right=1.
    board
        Layout of the sheet or board (JSON), as `trinoc pattern` writes it.
    every_s
        Interval between checked images in seconds. The sharpest image of each interval is used.
    keep : FOLDER (default: beside the rig)
        Folder for useful shots (PNG). Shots that are already there are used, too.
    report
        Write an HTML report to this file, too: verdict, cameras, residuals, uncertainty over the
        field, and matches.
    out
        Calibrate with the useful shots, and write the rig to this file; for one camera without a
        name, the lens.
    once
        Check the images that exist now, and end.
    port : N|open|none (default: a free one)
        Port of the progress page on 127.0.0.1, which other machines cannot reach. open: also open
        the page in a browser. none: no page.
    """
    if not 0 < every_s <= 3600:
        raise UsageError(f"--every-s is {every_s:g}: give seconds, such as 1.")
    number = None if port == "none" else _read_port(port)
    if report is not None and out is None:
        raise UsageError(
            "--report needs a calibration of a rig: give the output file of the rig with -o."
        )
    sources_of_views = _places(sources)
    kind = _kind(sources_of_views, once=once, keep=keep)
    target = _target(board)
    _expect_results(out, report, sources, "" in sources_of_views, job)
    from trinoc.serving.session import WatchSession
    from trinoc.serving.sources import open_source

    # Before the page is shown: what is no source ends the command.
    moments = open_source(sources_of_views, every_s, once=once, warn=LOGGER.warning)
    saved_shots = _open_kept(sources_of_views, kind, keep, out)
    stream = sys.stderr if job.json else sys.stdout
    is_silent = job.json and job.quiet

    def say(line: str) -> None:
        if not is_silent:
            print(line, file=stream, flush=True)

    session = WatchSession(target, " ".join(sources), tuple(sources_of_views), saved_shots, say)
    with contextlib.ExitStack() as stack:
        if number is not None and not once:
            _show(stack.enter_context(session.serve(number)), port == "open")
        _look(session, moments, must_go_on=out is not None)
        if out is None:
            return _summary(session)
        return _Calibration(session, Path(sources[0]), board, keep, report, out, job).run()


def _places(sources: tuple[str, ...]) -> dict[str, str]:
    """Source of each camera; a single camera without a name has the name ""."""
    if not sources:
        raise UsageError("No source is given: give a folder, a camera's number, or a video.")
    if len(sources) == 1 and "=" not in sources[0]:
        return {"": sources[0]}
    return {name: str(file) for name, file in files_of_views(sources).items()}


def _kind(sources: Mapping[str, str], *, once: bool, keep: Path | None) -> str:
    """Kind of the sources: "camera", "video" or "folder".

    Raises UsageError if the kinds differ, or if an option does not apply to this kind.
    """
    from trinoc.serving.sources import find_kind

    kinds = {find_kind(source) for source in sources.values()}
    if len(kinds) > 1:
        for source in sources.values():
            if not (source.isdecimal() or Path(source).exists()):
                raise UsageError(f"{source} does not exist: check the name.")
        raise UsageError(
            "Cameras, folders and videos cannot be combined: give sources of one kind."
        )
    if len({int(p) if p.isdecimal() else Path(p) for p in sources.values()}) < len(sources):
        raise UsageError("Two cameras have the same source: give each camera its own source.")
    (kind,) = kinds
    if once and kind != "folder":
        raise UsageError(
            "--once is an option for folders: a camera always has a next picture, and a video ends "
            "by itself. Omit --once."
        )
    if keep is not None and kind == "folder" and "" in sources:
        raise UsageError(
            "--keep is an option for cameras: the pictures of a folder remain in the folder. Omit "
            "--keep."
        )
    return kind


def _target(board: Path) -> "AbstractTarget":
    target = trinoc.io.load_target(board)
    if isinstance(target, trinoc.calib.BoardSet):
        raise UsageError(
            f"{board} contains several boards, but only one can be watched: give the layout of one "
            "board."
        )
    return target


def _expect_results(
    out: Path | None, report: Path | None, sources: tuple[str, ...], is_lens: bool, job: Job
) -> None:
    """Raise InputError or UsageError if the results cannot be written."""
    if out is None:
        return
    if is_lens and report is not None:
        raise UsageError(
            "A camera without a name gives only a lens, which has no report: name the camera, such "
            f"as camera={sources[0]}, to calibrate a rig of one camera."
        )
    job.expect(trinoc.Intrinsics if is_lens else trinoc.Rig, out, report)


def _open_kept(
    sources: Mapping[str, str], kind: str, keep: Path | None, out: Path | None
) -> "KeptShots | None":
    """Folder of saved shots: that of --keep, or one named after the result; None without both."""
    from trinoc.serving.kept_shots import KeptShots

    if keep is not None:
        saved_shots = KeptShots(keep, tuple(sources))
        watched = {Path(source).resolve() for source in sources.values()}
        if watched & {source.resolve() for source in saved_shots.folders.values()}:
            raise UsageError(
                f"--keep {keep} would write into a folder that is watched: give another folder."
            )
        return saved_shots
    if out is None or (kind == "folder" and "" in sources):
        return None
    saved_shots = KeptShots(out.with_name(f"{out.stem}_shots"), tuple(sources))
    if saved_shots.names():
        raise UsageError(
            f"{saved_shots.folder} contains {len(saved_shots.names())} shots of an earlier run: "
            f"continue that run with --keep {shlex.quote(str(saved_shots.folder))}, or give "
            "another folder."
        )
    return saved_shots


def _look(session: "WatchSession", moments: "Iterator[Moment]", *, must_go_on: bool) -> None:
    """Evaluate all moments, until they end or the user presses Ctrl-C.

    must_go_on : True to log an error of the source, after the first shot, and not to raise it.
    """
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
        if not (must_go_on and session.shots):
            raise
        LOGGER.warning("%s", error)


def _summary(session: "WatchSession") -> Outcome:
    written = [] if session.kept is None else session.kept.written
    return Outcome(session.summarise(), session.record(), written=written)


class _Calibration(NamedTuple):
    """Calibration with the shots of a watch session; the session's page shows its progress."""

    session: "WatchSession"
    source: Path
    board: Path
    keep: Path | None
    report: Path | None
    out: Path
    job: Job

    def run(self) -> Outcome:
        """Calibrate if there are enough shots. Return the outcome of session and calibration."""
        from trinoc.capture.shots import find_missing

        session, summary = self.session, _summary(self.session)
        missing = find_missing(session.informative_shots, session.cameras)
        if missing is not None:
            return self._refuse(summary, missing)
        LOGGER.info("calibrating with %d shots", len(session.informative_shots))
        session.announce("Calibrating with the kept shots ...")
        try:
            outcome = self._calibrate_rig() if session.is_named else self._calibrate_lens()
        except TrinocError as error:
            return self._refuse(summary, str(error))
        except KeyboardInterrupt:
            raise Interruption(f"Interrupted: {self._way_on()}") from None
        session.wait_for_reader()
        return Outcome(
            f"{summary.text}\n{outcome.text}",
            {**summary.record, "calibration": outcome.record},
            refusal=outcome.refusal,
            written=[*(summary.written or ()), *(outcome.written or ())],
        )

    def _calibrate_lens(self) -> Outcome:
        session = self.session
        if session.kept is not None:
            folder, names = session.kept.folder, [f"{n}.png" for n in session.kept.names()]
        else:
            folder, names = self.source, [s.name for s in session.shots if s.good_cameras]
        images = tuple(folder / name for name in names)
        outcome = intrinsics(images, board=(self.board,), out=self.out, job=self.job)
        session.announce("The lens is calibrated.", [f"written: {self.out}"], is_last=True)
        return outcome

    def _calibrate_rig(self) -> Outcome:
        import numpy as np

        from trinoc.report.checks import Level
        from trinoc.report.html import judge_shots

        session = self.session
        assert session.kept is not None
        folders = {name: Path(folder) for name, folder in session.kept.folders.items()}
        result, outcome = calibrate_shots(
            folders, (self.board,), (), {}, {}, self.report, self.out, self.job
        )
        verdict, advice = judge_shots(result), outcome.record["next_shot"]
        if advice is not None and result.has_rig:
            session.draw_next_shot(
                result.rig, advice["cameras"], np.array(advice["world_from_board"])
            )
        if verdict is None:
            return outcome
        files = ", ".join(str(path) for path in (self.out, self.report) if path is not None)
        details = [verdict.reason, f"written: {files}"]
        details += [] if advice is None else [advice["sentence"]]
        tones: Any = {Level.GOOD: "good", Level.BAD: "bad"}
        session.announce(
            verdict.sentence, details, tone=tones.get(verdict.level, "plain"), is_last=True
        )
        return outcome._replace(text=f"{outcome.text}\n{verdict.sentence} {verdict.reason}")

    def _refuse(self, summary: Outcome, why: str) -> Outcome:
        self.session.announce(why, tone="bad", is_last=True)
        self.session.wait_for_reader()
        return summary._replace(refusal=f"{why} {self._way_on()}")

    def _way_on(self) -> str:
        """Sentence with the folder of the shots and the command that continues with them."""
        command_line = self.job.command_line
        if self.session.kept is None:
            return f"The pictures remain in their folder. To continue, run: {command_line}"
        folder = shlex.quote(str(self.session.kept.folder))
        keep_option = "" if self.keep is not None else f" --keep {folder}"
        return f"The shots are kept in {folder}. To continue, run: {command_line}{keep_option}"


def _read_port(port: str | int) -> int:
    """Port number; 0 for a free port.

    Raises UsageError here, because an error in the server's thread would leave the command waiting.
    """
    if isinstance(port, str):
        return 0
    if not 0 <= port <= 65535:
        raise UsageError(
            f"--port is {port}: give a port up to 65535, or omit --port for a free port."
        )
    return port


def _show(url: str, browser: bool) -> None:
    """Print the address of the page to stderr. It is printed even with `--quiet`, because it is
    needed.

    browser : True to open the page in a browser.
    """
    print(f"trinoc: open {url} in a browser; press Ctrl-C to stop", file=sys.stderr, flush=True)
    if browser:
        import webbrowser

        webbrowser.open(url)
