"""`trinoc batch`: a recording, frame by frame, to matched 3-D segments."""

import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import trinoc
from trinoc.cli.command import LOGGER, Interruption, Job, Outcome, UsageError, pick
from trinoc.cli.options import Settings
from trinoc.cli.segments import ANYWHERE, depth_range, find_settings
from trinoc.cli.views import SEGMENT_SUFFIXES, doubts_table, find_doubts, read_rig
from trinoc.errors import list_names

if TYPE_CHECKING:
    from trinoc.batch.run import BatchOutcome, BatchProgress

# Where no bar can be drawn, a line so often.
LINE_EVERY_S = 60.0


def batch(
    frames: Path,
    /,
    *,
    rig: Path,
    template: str | None = None,
    shard: str = "1/1",
    frames_per_file: int = 16,
    workers: str | None = None,
    memory_gb: float | None = None,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] = ANYWHERE,
    find: Settings = (),
    report: Path | None = None,
    out: Path = Path("matches"),
    job: Job,
) -> Outcome:
    """Match every frame of a recording. After an interruption, the same command continues.

    Parameters
    ----------
    frames : FOLDER|TABLE.csv
        A folder of images or segment files, or a CSV table with a column "frame" and one column of
        file names for each camera.
    rig
        The calibrated cameras, as `trinoc calibrate` writes them. A frame needs a file for each.
    template : (default: usual templates are tried)
        Pattern of the file names: {frame}_{camera}.png or {camera}/{frame}.tif; * is any text.
    shard : I/N
        Compute part I of N. The parts may run at the same time in one folder of results.
    frames_per_file
        Number of frames that are matched together and written to one file.
    workers : N|tcp://... (default: all cores)
        Largest number of processes on this machine (threads for short recordings), or the address
        of a Dask scheduler.
    memory_gb : GB (default: half of the machine's)
        Memory that this process may use.
    sigma_px : PX (default: that of each segment)
        Standard deviation of the segments' end points across the segment, the same for all.
    depth_range_mm : NEAR FAR (default: any depth in front of the cameras)
        Smallest and largest depth of the lines, in front of every camera that sees them.
    find
        Options of the segment detector, as in `trinoc segments`: tolerance_px=1.6, false_alarms=1,
        least_contrast=7, arcs=no, response=linear.
    report
        Write an HTML report to this file, too: verdict, cameras, residuals, uncertainty over the
        field, and matches.
    out : FOLDER
        Folder of the results.
    """
    settings, depths_mm = find_settings(find), depth_range(depth_range_mm)
    threads, scheduler = _workers(workers)
    job_of_jobs = _shard(shard)
    positive = {
        "frames-per-file": frames_per_file,
        "memory-gb": memory_gb,
        "sigma-px": sigma_px,
    }
    for name, value in positive.items():
        if value is not None and not value > 0:
            raise UsageError(f"--{name} is {value:g}: give more than 0.")

    cameras = read_rig(rig)
    progress = _Progress(quiet=job.quiet)
    try:
        outcome = trinoc.match_recording(
            frames,
            cameras,
            out,
            template=template,
            find=settings,
            sigma_px=sigma_px,
            depth_range_mm=depths_mm,
            shard=job_of_jobs,
            frames_per_file=frames_per_file,
            threads_at_most=threads,
            in_processes=True,
            scheduler=scheduler,
            memory_gb=memory_gb,
            on_progress=progress.show,
        )
    except KeyboardInterrupt as error:
        raise Interruption(
            f"Interrupted: {progress.done} of {progress.total} frames are done and kept in {out}; "
            "run the same command again to continue."
        ) from error
    finally:
        progress.close()
    if report is not None and outcome.failed < outcome.frames:
        content = _report_content(frames, out, cameras, template, settings, depths_mm)
        files = content.pop("files")
        job.write_report(
            report,
            job.provenance({**files, "rig": rig}),
            tables=doubts_table(rig),
            doubts=find_doubts(rig),
            **content,
        )
    return _outcome(outcome, report)


def _report_content(
    frames: Path,
    out: Path,
    rig: "trinoc.Rig",
    template: str | None,
    find: dict[str, Any],
    depths_mm: tuple[float, float] | None,
) -> dict[str, Any]:
    """Contents of the report: all frames in the folder of results, and the middle frame in full.

    The middle frame is shown with its pictures. depths_mm : depth range of the matching.
    """
    from trinoc.batch.source import find_frames
    from trinoc.batch.work import MatchingJob, frame_segments
    from trinoc.report.frames_part import frames_part

    LOGGER.info("reading the results of all frames")
    results = trinoc.load_recording(out)
    recording = frames_part(results, results.failures)
    source = find_frames(frames, rig.names, template)
    rig = rig.take(source.views)
    (frame,) = (each for each in source.frames if each.name == recording.middle)
    files = {name: source.folder / frame.files[name] for name in rig.names}
    return {
        "files": files,
        "rig": rig,
        "segments": frame_segments(MatchingJob(source.folder, rig, find, depths_mm), frame),
        "matches": results[frame.name],
        "scene_pictures": {
            name: trinoc.io.read_image(file)
            for name, file in files.items()
            if file.suffix.lower() not in SEGMENT_SUFFIXES
        },
        "title": f"Recording of {len(results):,} frames",
        "recording": recording,
    }


def _outcome(result: "BatchOutcome", report: Path | None) -> Outcome:
    sentences = [f"{result.frames} frames done, {result.tracks} tracks"]
    if result.earlier:
        sentences.append(f"{result.earlier} of the frames by an earlier run")
    if result.without:
        sentences.append(f"no picture of {list_names(result.without)}, which were left out")
    if result.failed:
        sentences.append(f"{result.failed} failed; the manifest contains the reasons")
    if result.suspect:
        sentences.append(f"{result.suspect} do not seem to belong to the rig")
    if result.uncertain:
        sentences.append(f"use {result.uncertain} with care; the manifest contains the reasons")
    record = pick(result, "frames", "failed", "suspect", "uncertain", "tracks", "earlier")
    record["workers"] = result.workers if result.frames > result.earlier else 0
    refusal = None
    if result.frames and result.failed == result.frames:
        refusal = f"All {result.frames} frames failed: {result.manifest} contains the reasons."
    elif result.suspect:
        refusal = (
            f"{result.suspect} of {result.frames} frames do not seem to belong to the rig: "
            f"{result.manifest} contains the reasons."
        )
    written = (result.folder, result.manifest, report)
    return Outcome(f"{'; '.join(sentences)}.", record, refusal, written)


def _shard(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    part, parts = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= part <= parts:
        raise UsageError(
            f"--shard is {text}, but must be the number of a job and the number of jobs: write 1/4 "
            "to 4/4 for four jobs."
        )
    return part, parts


def _workers(text: str | None) -> tuple[int | None, str | None]:
    """Return the largest number of threads and the address of a Dask scheduler, each or None.

    Raises UsageError if the text is neither a number nor an address.
    """
    if text is None or "://" in text:
        return None, text
    if not (text.isdecimal() and int(text)):
        raise UsageError(
            f"--workers is {text}: give a number of processes, such as 4, or the address of a Dask "
            "scheduler, such as tcp://localhost:8786."
        )
    return int(text), None


class _Progress:
    """Progress on stderr: a bar with rate and time on a terminal, otherwise a line per minute."""

    def __init__(self, *, quiet: bool) -> None:
        self.done, self.total = 0, 0
        self._quiet, self._bar = quiet, None
        self._first: BatchProgress | None = None
        self._start_s = self._last_s = 0.0

    def show(self, progress: "BatchProgress") -> None:
        """Show the progress and store it."""
        self.done, self.total = progress.done, progress.total
        if self._quiet:
            return
        if sys.stderr.isatty():
            self._draw(progress)
        else:
            self._log(progress)

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()

    def _draw(self, progress: "BatchProgress") -> None:
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(
                desc="trinoc: frames",
                unit="frame",
                total=progress.total,
                initial=progress.done,
                leave=False,
                file=sys.stderr,
            )
        if progress.failed:
            self._bar.set_postfix_str(f"{progress.failed} failed", refresh=False)
        self._bar.update(progress.done - self._bar.n)

    def _log(self, progress: "BatchProgress") -> None:
        now_s = time.monotonic()
        if self._first is None:
            self._first, self._start_s, self._last_s = progress, now_s, now_s
            LOGGER.info("%d of %d frames are done", progress.done, progress.total)
            return
        if now_s - self._last_s < LINE_EVERY_S and progress.done < progress.total:
            return
        self._last_s = now_s
        frames = progress.done - self._first.done
        rate = max(frames / max(now_s - self._start_s, 1e-9), 1e-9)
        minutes = (progress.total - progress.done) / rate / 60
        failed = f", {progress.failed} failed" if progress.failed else ""
        LOGGER.info(
            "%d of %d frames%s, %.2f frames/s, %.0f min left",
            *(progress.done, progress.total, failed, rate, minutes),
        )
