"""Matching of a recording into a folder; a repeated call continues after an interruption."""

import dataclasses
import hashlib
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import trinoc
from trinoc.batch.folder import open_results
from trinoc.batch.source import Source, find_frames
from trinoc.batch.work import MatchingJob
from trinoc.batch.workers import cluster, in_window, processes, threads
from trinoc.errors import InputError, TrinocError, check_kind, real_number
from trinoc.geometry.rig import A_RIG, Rig
from trinoc.io.frames_files import frames_ending
from trinoc.io.rig_json import rig_text
from trinoc.recording.frame_table import FrameMatches
from trinoc.recording.parts import RecordingPart, cut_into_parts, share_parts


class BatchProgress(NamedTuple):
    """Progress of a job: numbers of finished frames, of failed frames, and of all its frames."""

    done: int
    failed: int
    total: int


@dataclasses.dataclass(frozen=True)
class BatchOutcome:
    """Result of a job.

    Attributes
    ----------
    folder, manifest : Path
        Folder of results, and its list of frames.
    frames, failed, tracks : int
        Numbers of frames, failed frames and tracks.
    suspect : int
        Number of SUSPECT frames, which probably belong to another rig.
    earlier : int
        Number of frames that an earlier run finished.
    workers : int
        Number of parallel workers.
    without : tuple of str
        Cameras of the rig without any image.
    uncertain : int
        Number of UNCERTAIN frames, to be used with care.
    """

    folder: Path
    manifest: Path
    frames: int
    failed: int
    suspect: int
    tracks: int
    earlier: int
    workers: int
    without: tuple[str, ...] = ()
    uncertain: int = 0


def match_recording(
    frames: str | os.PathLike[str],
    rig: Rig,
    out: str | os.PathLike[str],
    *,
    template: str | None = None,
    find: Mapping[str, Any] | None = None,
    sigma_px: float | None = None,
    depth_range_mm: tuple[float, float] | None = None,
    shard: tuple[int, int] = (1, 1),
    frames_per_file: int = 16,
    ending: str | None = None,
    threads_at_most: int | None = None,
    in_processes: bool = False,
    scheduler: str | None = None,
    memory_gb: float | None = None,
    on_progress: Callable[[BatchProgress], None] | None = None,
) -> BatchOutcome:
    """Detect and match the segments of every frame of a recording, and write them to a folder.

    Parameters
    ----------
    frames : path
        A folder, or a CSV table with the columns frame and one per camera of the rig. Files are
        images, or segments as `load_segments` reads them.
    rig : Rig
        The cameras; a frame needs a file of each. If three or more cameras have files, those
        without any are dropped.
    out : path
        Folder of results. If it has results of the same recording, the rest is computed.
    template : str, optional
        Template of the file names, such as "{frame}_{camera}.png" or "{camera}/{frame}.tif".
        Default: usual templates are tried.
    find : mapping, optional
        Options of `find_segments`.
    sigma_px, depth_range_mm : optional
        As in `match_segments`.
    shard : (i, n)
        Job i of n, from 1, computes every n-th file of results. Jobs may run at the same time in
        one folder.
    frames_per_file : int
        Number of frames that are matched together and written to one file.
    ending : str, optional
        ".npz" or ".parquet". Default: Parquet if pyarrow is installed.
    threads_at_most : int, optional
        Largest number of threads. Default: number of cores. Fewer are used if memory is too small
        for the images.
    in_processes : bool
        Use processes in place of threads for long recordings: 1.6 times faster on two cores. A
        script then needs `if __name__ == "__main__":`.
    scheduler : str, optional
        Address of a Dask scheduler whose workers replace the threads.
    memory_gb : float, optional
        Memory for this process. Default: half of the machine's. Above it, no part starts before
        others are written.
    on_progress : callable, optional
        Called with a BatchProgress after each file of results.

    Returns
    -------
    BatchOutcome
        A failed frame has a manifest line with the reason, and does not stop the others. The files
        do not depend on threads, processes, cluster, jobs or interruptions.

    Raises
    ------
    InputError
        If there are no frames, `out` has other results, or another program is writing there.
    """
    check_kind(rig, Rig, "rig", A_RIG)
    options = {
        "frames_per_file": frames_per_file,
        "threads_at_most": threads_at_most,
        "memory_gb": memory_gb,
        "sigma_px": sigma_px,
    }
    for name, value in options.items():
        if value is not None and not real_number(value, name) > 0:
            raise InputError(f"{name} is {value}, but must be positive.")
    if ending not in (None, ".npz", ".parquet"):
        raise InputError(f'ending is "{ending}". Choose ".npz" or ".parquet".')
    source = find_frames(frames, rig.names, template)
    without = tuple(name for name in rig if name not in source.views)
    rig = rig.take(source.views)
    parts = share_parts(cut_into_parts(source.frames, frames_per_file), shard)
    ending = ending or _existing_ending(Path(out)) or frames_ending()
    job = MatchingJob(source.folder.resolve(), rig, dict(find or {}), depth_range_mm, sigma_px)
    description = _description(source, job, frames_per_file, ending)
    memory = half_of_memory() if memory_gb is None else memory_gb * 1e9
    with open_results(Path(out), shard, description, ending) as folder:
        folder.look(parts)
        earlier = folder.tally["frames"]
        open_parts = [part for part in parts if part.number not in folder.done]
        total = sum(len(part.frames) for part in parts)

        def report_progress() -> None:
            if on_progress is not None:
                tally = folder.tally
                on_progress(BatchProgress(tally["frames"], tally["failed"], total))

        report_progress()
        wanted = threads_at_most or os.cpu_count() or 1
        use_processes = in_processes and 1 < wanted <= len(open_parts) // FEWEST_PARTS
        affordable = affordable_processes if use_processes else affordable_threads
        count = min(affordable(memory, rig, wanted), max(len(open_parts), 1))
        if scheduler is not None:
            worker_context = cluster(job, scheduler)
        else:
            worker_context = (
                processes(job, count) if use_processes and count > 1 else threads(job, count)
            )
        with worker_context as workers:
            window = PARTS_PER_WORKER * workers.count
            for part, future in in_window(
                workers.executor, workers.do, open_parts, window, lambda: resident_bytes() < memory
            ):
                folder.commit(part.number, _result(part, future, workers.where), rig.names)
                report_progress()
        folder.order()
        tally = folder.tally
        return BatchOutcome(
            folder=folder.path,
            manifest=folder.manifest,
            frames=tally["frames"],
            failed=tally["failed"],
            suspect=tally["suspect"],
            tracks=tally["tracks"],
            earlier=earlier,
            workers=workers.count,
            without=without,
            uncertain=tally["uncertain"],
        )


def _result(part: RecordingPart, future: Future[Any], where: str) -> list[FrameMatches]:
    try:
        return future.result()
    except TrinocError:
        raise
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            reason = (
                "The worker processes of this part of the recording died. Check their logs for "
                "lack of memory."
            )
            return [FrameMatches(frame.name, reason, None) for frame in part.frames]
        raise InputError(
            f"The processing at {where} ended early ({type(error).__name__}: {error}). Finished "
            "results are kept; run the same command again to continue."
        ) from error


def _description(
    source: Source, work: MatchingJob, frames_per_file: int, ending: str
) -> dict[str, Any]:
    """Inputs and options that the results depend on, for comparison with an earlier run.

    Input files are represented by a hash of their content.
    """
    listed = "\n".join(f"{f.name}\t{c}\t{f.files[c]}" for f in source.frames for c in f.files)
    return {
        "format": "trinoc-recording",
        "version": 1,
        "trinoc": trinoc.__version__,
        "views": list(work.rig.names),
        "frames": len(source.frames),
        "files_sha256": hashlib.sha256(listed.encode("utf-8", "surrogateescape")).hexdigest(),
        "rig_sha256": hashlib.sha256(rig_text(work.rig).encode()).hexdigest(),
        "find": dict(sorted(work.find.items())),
        "depth_range_mm": None if work.depth_range_mm is None else list(work.depth_range_mm),
        "frames_per_file": frames_per_file,
        "ending": ending,
        # Folders of results from before this option have no such key.
        **({} if work.sigma_px is None else {"sigma_px": work.sigma_px}),
    }


def _existing_ending(out: Path) -> str | None:
    """File ending of existing results, which new ones must have too; None if there are none."""
    endings = {path.suffix for path in out.glob("matches-*")} & {".npz", ".parquet"}
    return min(endings, default=None)


BASE_BYTES = 700_000_000
BYTES_PER_PIXEL = 60
# Fewest parts per process for which a process is faster than a thread.
FEWEST_PARTS = 3
# Open parts (started or not yet written) per worker.
PARTS_PER_WORKER = 2


def affordable_threads(memory_bytes: float, rig: Rig, wanted: int) -> int:
    """Number of threads that fit in memory, from 1 to `wanted`."""
    count = (memory_bytes - BASE_BYTES) / _bytes_of_picture(rig)
    return max(1, min(wanted, int(count)))


def affordable_processes(memory_bytes: float, rig: Rig, wanted: int) -> int:
    """Number of processes that fit in memory beside this one, from 1 to `wanted`."""
    count = (memory_bytes - BASE_BYTES) / (BASE_BYTES + _bytes_of_picture(rig))
    return max(1, min(wanted, int(count)))


def _bytes_of_picture(rig: Rig) -> int:
    sizes = (rig[name].image_size_px for name in rig.names)
    return BYTES_PER_PIXEL * max(width * height for width, height in sizes)


def half_of_memory() -> float:
    """Half of the machine's memory in bytes; infinite if unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2
    except (AttributeError, OSError, ValueError):
        return float("inf")


def resident_bytes() -> int:
    """Memory of this process in bytes; 0 if unknown."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
