"""`trinoc batch`: a recording, frame by frame, to matched 3-D segments."""

import contextlib
import dataclasses
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from trinoc.cli.command import (
    LOGGER,
    Command,
    Interruption,
    Out,
    Outcome,
    ReportOption,
    UsageError,
)
from trinoc.cli.segments import DepthOption, FindOption
from trinoc.cli.views import SEGMENT_SUFFIXES, doubts_table, find_doubts, read_rig
from trinoc.errors import list_names

if TYPE_CHECKING:
    from trinoc.batch.run import BatchOutcome, BatchProgress
    from trinoc.geometry.rig import Rig

# Where no bar can be drawn, a line so often.
LINE_EVERY_S = 60.0
_BY_ITSELF = "(default: found by itself)"


@dataclasses.dataclass(frozen=True, kw_only=True)
class BatchCommand(DepthOption, FindOption, ReportOption, Command):
    """Match every frame of a recording. Stopped or killed, the same command goes on."""

    frames: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER|TABLE.csv")]
    """A folder of pictures (or segments), or a CSV table: a column frame, and a column of file
    names for each camera."""

    rig: Path
    """The cameras, as `trinoc calibrate` writes them; a frame needs a file of each."""

    template: Annotated[str | None, tyro.conf.arg(help_behavior_hint=_BY_ITSELF)] = None
    """How the files are named: {frame}_{camera}.png, {camera}/{frame}.tif, with * for anything."""

    shard: Annotated[str, tyro.conf.arg(metavar="I/N")] = "1/1"
    """Job I of N, which does each N-th file of results; jobs may run at once in one folder."""

    frames_per_file: int = 16
    """Frames that are matched together and stand in one file of results."""

    workers: Annotated[
        str | None,
        tyro.conf.arg(metavar="N|tcp://...", help_behavior_hint="(default: all cores)"),
    ] = None
    """Processes of this machine, at most, or threads for short recordings; or the address of a Dask
    scheduler, whose workers take their place."""

    memory_gb: Annotated[
        float | None, tyro.conf.arg(help_behavior_hint="(default: half of the machine's)")
    ] = None
    """Memory that this process may take."""

    out: Out = Path("matches")
    """The folder of results."""

    def run(self, command_line: str) -> Outcome:
        """Match all frames that are not done."""
        settings = self.find_settings()
        threads, scheduler = _workers(self.workers)
        shard = _shard(self.shard)
        depths = self.depths_mm()
        for name in ("frames_per_file", "memory_gb"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise UsageError(f"--{name.replace('_', '-')} is {value:g}: give more than 0.")

        from trinoc.batch.run import match_recording

        rig = read_rig(self.rig)
        with _progress(self.quiet) as tell:
            try:
                outcome = match_recording(
                    self.frames,
                    rig,
                    self.out,
                    template=self.template,
                    find=settings,
                    depth_range_mm=depths,
                    shard=shard,
                    frames_per_file=self.frames_per_file,
                    threads_at_most=threads,
                    in_processes=True,
                    scheduler=scheduler,
                    memory_gb=self.memory_gb,
                    on_progress=tell,
                )
            except KeyboardInterrupt as error:
                raise Interruption(
                    f"Interrupted: {tell.done} of {tell.total} frames are done and kept in "
                    f"{self.out}; the same command goes on from there."
                ) from error
        if self.report is not None and outcome.failed < outcome.frames:
            self._write_report(rig, command_line)
        return _outcome(outcome, self.report)

    def _write_report(self, rig: "Rig", command_line: str) -> None:
        """All frames of the folder, and the middle one with its pictures."""
        from trinoc.batch.source import find_frames
        from trinoc.batch.work import MatchingJob, frame_segments
        from trinoc.cli.command import provenance
        from trinoc.io.frames_files import load_recording
        from trinoc.io.images import read_image
        from trinoc.report.frames_part import frames_part

        LOGGER.info("reading the results of all frames")
        results = load_recording(self.out)
        recording = frames_part(results, results.failures)
        source = find_frames(self.frames, rig.names, self.template)
        rig = rig.take(source.views)
        (frame,) = (each for each in source.frames if each.name == recording.middle)
        files = {name: source.folder / frame.files[name] for name in rig.names}
        job = MatchingJob(source.folder, rig, self.find_settings(), self.depths_mm())
        self.write_report(
            provenance(command_line, {**files, "rig": self.rig}),
            rig=rig,
            segments=frame_segments(job, frame),
            matches=results[frame.name],
            scene_pictures={
                name: read_image(file)
                for name, file in files.items()
                if file.suffix.lower() not in SEGMENT_SUFFIXES
            },
            title=f"Recording of {len(results):,} frames",
            tables=doubts_table(self.rig),
            doubts=find_doubts(self.rig),
            recording=recording,
        )


def _outcome(found: "BatchOutcome", report: Path | None) -> Outcome:
    here = found.frames - found.earlier
    parts = [f"{found.frames} frames done, {found.tracks} tracks"]
    if found.earlier:
        parts.append(f"{found.earlier} of the frames by an earlier run")
    if found.without:
        parts.append(f"no picture of {list_names(found.without)}, which were left out")
    if found.failed:
        parts.append(f"{found.failed} failed; the manifest says why")
    if found.suspect:
        parts.append(f"{found.suspect} do not seem to belong to the rig")
    if found.uncertain:
        parts.append(f"use {found.uncertain} with care; the manifest says why")
    record = {
        "frames": found.frames,
        "failed": found.failed,
        "suspect": found.suspect,
        "uncertain": found.uncertain,
        "tracks": found.tracks,
        "earlier": found.earlier,
        "workers": found.workers if here else 0,
    }
    refusal = None
    if found.frames and found.failed == found.frames:
        refusal = f"All {found.frames} frames failed: {found.manifest} says why."
    elif found.suspect:
        refusal = (
            f"{found.suspect} of {found.frames} frames do not seem to belong to the rig: "
            f"{found.manifest} says why."
        )
    written = (found.folder, found.manifest, report)
    return Outcome(f"{'; '.join(parts)}.", record, refusal, written)


def _shard(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    job, jobs = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= job <= jobs:
        raise UsageError(f"--shard {text} is no job: write 1/4 to 4/4 for four of them.")
    return job, jobs


def _workers(text: str | None) -> tuple[int | None, str | None]:
    """(threads at most, address of a scheduler). Raises UsageError."""
    if text is None or "://" in text:
        return None, text
    if not (text.isdecimal() and int(text)):
        raise UsageError(
            f"--workers is {text}: give a number of processes, such as 4, or the address of a Dask "
            "scheduler, such as tcp://localhost:8786."
        )
    return int(text), None


class _Teller:
    """Takes note of the progress, and shows it on stderr."""

    def __init__(self, show: "Callable[[BatchProgress], None]") -> None:
        self.done, self.total, self._show = 0, 0, show

    def __call__(self, progress: "BatchProgress") -> None:
        self.done, self.total = progress.done, progress.total
        self._show(progress)


@contextlib.contextmanager
def _progress(quiet: bool) -> Iterator[_Teller]:
    """A bar with rate and time left on a terminal, a line a minute elsewhere."""
    if quiet:
        yield _Teller(lambda _: None)
        return
    if not sys.stderr.isatty():
        yield _Teller(_Lines())
        return

    from tqdm import tqdm

    with tqdm(desc="trinoc: frames", unit="frame", leave=False, file=sys.stderr) as bar:

        def show(progress: "BatchProgress") -> None:
            if bar.total is None:
                bar.total, bar.initial, bar.n = progress.total, progress.done, progress.done
            if progress.failed:
                bar.set_postfix_str(f"{progress.failed} failed", refresh=False)
            bar.update(progress.done - bar.n)

        yield _Teller(show)


class _Lines:
    """Progress as lines of a log."""

    def __init__(self) -> None:
        self._start, self._last, self._at_start = 0.0, 0.0, 0

    def __call__(self, progress: "BatchProgress") -> None:
        now = time.monotonic()
        if not self._start:
            self._start = self._last = now
            self._at_start = progress.done
            LOGGER.info("%d of %d frames are done", progress.done, progress.total)
            return
        if now - self._last < LINE_EVERY_S and progress.done < progress.total:
            return
        self._last = now
        rate = max((progress.done - self._at_start) / max(now - self._start, 1e-9), 1e-9)
        minutes = (progress.total - progress.done) / rate / 60
        failed = f", {progress.failed} failed" if progress.failed else ""
        LOGGER.info(
            "%d of %d frames%s, %.2f frames/s, %.0f min left",
            *(progress.done, progress.total, failed, rate, minutes),
        )
