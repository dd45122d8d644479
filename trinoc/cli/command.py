"""Parts that commands share: common options, the outcome, and progress on stderr."""

import dataclasses
import hashlib
import logging
import math
import os
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import trinoc
from trinoc.errors import InputError

LOGGER = logging.getLogger("trinoc")

_Item = TypeVar("_Item")


def set_up_logging(*, quiet: bool) -> None:
    """Send the log of the package to stderr. quiet : True for warnings only."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("trinoc: %(message)s"))
    LOGGER.handlers[:] = [handler]
    LOGGER.setLevel(logging.WARNING if quiet else logging.INFO)
    LOGGER.propagate = False


class UsageError(InputError):
    """Error in the command line. The exit status is 2, not 1."""


class Interruption(KeyboardInterrupt):
    """Ctrl-C in a job that keeps its finished results. The text of the exception states this."""


class Outcome(NamedTuple):
    """Output of a command.

    Attributes
    ----------
    text : str
        Output for people.
    record : mapping
        Output as one JSON object for programs.
    refusal : str, optional
        Reason why the command counts as failed although it has output; None for success.
    written : sequence of paths, optional
        Files that were written; None in place of a file that was not requested. None for a command
        that writes no files.
    """

    text: str
    record: dict[str, Any]
    refusal: str | None = None
    written: Sequence[Path | None] | None = None

    def with_files(self) -> "Outcome":
        """Return the outcome with the written files added to text and record."""
        if self.written is None:
            return self
        names = [str(path) for path in self.written if path is not None]
        lines = [f"written: {', '.join(names)}"] if names else []
        return self._replace(
            text="\n".join([self.text, *lines]), record={**self.record, "written": names}
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Job:
    """Options and steps that most commands share.

    Attributes
    ----------
    json : bool
        Print one JSON object.
    quiet : bool
        Show no progress.
    force : bool
        Overwrite an output file that contains a value of another kind.
    command_line : str
        Command as the user typed it, for the provenance of files.
    """

    json: bool = False
    quiet: bool = False
    force: bool = False
    command_line: str = ""

    def expect(self, kind: type, out: Path | None, *others: Path | None) -> None:
        """Check, before any work, that a value of type `kind` can be written to `out`.

        Raises InputError if it cannot.

        others : further output files, of any type.
        """
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable

        expect_place(out, *others)
        expect_replaceable(out, kind, force=self.force)

    def provenance(self, inputs: Mapping[str, str | os.PathLike[str]]) -> dict[str, Any]:
        """Return the "provenance" object for output files. It has no date, so equal inputs give
        equal objects.

        inputs : input files by name.
        """
        return {
            "command": self.command_line,
            "version": trinoc.__version__,
            "inputs": {
                name: {
                    "file": Path(path).name,
                    "sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest(),
                }
                for name, path in inputs.items()
            },
        }

    def write_report(
        self, report: Path | None, provenance: Mapping[str, Any], **content: Any
    ) -> None:
        """Write the HTML report if its path is given. content : arguments of
        `trinoc.report.write_report`.
        """
        if report is None:
            return
        from trinoc.report.html import write_report

        LOGGER.info("writing %s", report)
        write_report(report, provenance=for_people(provenance), **content)

    def each(self, items: Collection[_Item], doing: str) -> Iterator[_Item]:
        """Yield the items with a progress bar on stderr. doing : what the bar says."""
        bar = Bar(doing, quiet=self.quiet)
        for number, item in enumerate(items):
            bar.show(number, len(items))
            yield item
        bar.close()


def for_people(origin: Mapping[str, Any]) -> dict[str, str]:
    """Provenance as names and texts, for the end of a report."""
    files = {
        name: f"{entry['file']} (sha256 {entry['sha256'][:12]})"
        for name, entry in origin["inputs"].items()
    }
    return {"command": origin["command"], "version": origin["version"], **files}


class Bar:
    """Progress bar on stderr."""

    def __init__(self, doing: str, *, quiet: bool) -> None:
        self._doing, self._quiet, self._bar = doing, quiet, None

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the bar from the terminal."""
        if self._bar is not None:
            self._bar.close()

    def show(self, done: int, total: int) -> None:
        """Show the progress: `done` of `total` steps."""
        if self._quiet or not sys.stderr.isatty():
            return
        from tqdm import tqdm

        if self._bar is None:
            text = f"trinoc: {self._doing}"
            self._bar = tqdm(total=total, desc=text, leave=False, file=sys.stderr)
        self._bar.update(done - self._bar.n)


def plan_outcome(
    what: str,
    files: Mapping[str, Path],
    sizes_px: Mapping[str, tuple[int, int]],
    outputs: Sequence[Path | None],
) -> Outcome:
    """Outcome of --dry-run: each camera with its file and image size, and the files to write.

    what : name of the job.
    """
    lines = [f"would {what}:"]
    for name, file in files.items():
        width, height = sizes_px[name]
        lines.append(f"  {name}: {file}, {width} x {height} px")
    would_write = [path for path in outputs if path is not None]
    lines += [f"would {'replace' if p.exists() else 'write'} {p}" for p in would_write]
    record = {
        "cameras": {name: str(file) for name, file in files.items()},
        "would_write": [str(path) for path in would_write],
    }
    return Outcome("\n".join(lines), record, written=())


def pick(value: object, *names: str) -> dict[str, Any]:
    """Attributes of a value by name, in a form that JSON supports."""
    return {name: as_json(getattr(value, name)) for name in names}


def as_json(value: Any) -> Any:
    """Convert a value to a form that JSON supports.

    Arrays and tuples become lists; NaN and infinity become null.
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(name): as_json(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
