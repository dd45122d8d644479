"""What every command is: options that tyro reads, a `run` that returns what to print, and the bar
that shows its progress.
"""

import abc
import dataclasses
import hashlib
import logging
import math
import os
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import tyro

import trinoc
from trinoc.errors import InputError

LOGGER = logging.getLogger("trinoc")

_Item = TypeVar("_Item")


def set_up_logging(*, quiet: bool) -> None:
    """Send the package's log to stderr: steps as well as warnings, or only warnings."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("trinoc: %(message)s"))
    LOGGER.handlers[:] = [handler]
    LOGGER.setLevel(logging.WARNING if quiet else logging.INFO)
    LOGGER.propagate = False


class Bar:
    """A progress bar on stderr for work that says how far it is."""

    def __init__(self, doing: str, *, quiet: bool) -> None:
        self._doing, self._quiet, self._bar = doing, quiet, None

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self, done: int, total: int) -> None:
        """Show that so many of so many are done."""
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(
                total=total,
                desc=f"trinoc: {self._doing}",
                leave=False,
                file=sys.stderr,
                disable=self._quiet or not sys.stderr.isatty(),
            )
        self._bar.update(done - self._bar.n)


def each(items: Collection[_Item], doing: str, *, quiet: bool) -> Iterator[_Item]:
    """The items, with a progress bar on stderr that leaves no trace."""
    from tqdm import tqdm

    yield from tqdm(
        items,
        desc=f"trinoc: {doing}",
        leave=False,
        file=sys.stderr,
        disable=quiet or not sys.stderr.isatty(),
    )


def provenance(command_line: str, inputs: Mapping[str, str | os.PathLike[str]]) -> dict[str, Any]:
    """The "provenance" object of a file; equal inputs give equal objects, so it has no date."""
    return {
        "command": command_line,
        "version": trinoc.__version__,
        "inputs": {
            name: {
                "file": Path(path).name,
                "sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest(),
            }
            for name, path in inputs.items()
        },
    }


def for_people(origin: Mapping[str, Any]) -> dict[str, str]:
    """The same as lines of text, for the foot of a report."""
    files = {
        name: f"{entry['file']} (sha256 {entry['sha256'][:12]})"
        for name, entry in origin["inputs"].items()
    }
    return {"command": origin["command"], "version": origin["version"], **files}


class UsageError(InputError):
    """The command line itself is wrong: exit status 2 instead of 1."""


class Interruption(KeyboardInterrupt):
    """Ctrl-C in a job that keeps what is done; the text says so."""


class Outcome(NamedTuple):
    """What a command has to say: text for people, or one JSON object for programs.

    refusal : why the job counts as failed although there is something to say; None where not.
    written : the files that it left, of which None were not asked for; None for a job that only
        says something.
    """

    text: str
    record: dict[str, Any]
    refusal: str | None = None
    written: Sequence[Path | None] | None = None

    def with_files(self) -> "Outcome":
        """The same with its files in the text and in the record."""
        if self.written is None:
            return self
        names = [str(path) for path in self.written if path is not None]
        said = [f"written: {', '.join(names)}"] if names else []
        return self._replace(
            text="\n".join([self.text, *said]), record={**self.record, "written": names}
        )


# The options that most commands have. A layout may also be called a pattern.
Out = Annotated[Path, tyro.conf.arg(aliases=("-o",))]
BoardFile = Annotated[Path, tyro.conf.arg(aliases=("--pattern",), metavar="FILE")]
FileOrNone = Annotated[
    Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")
]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReportOption:
    """Of commands that also write what they found as a page."""

    report: FileOrNone = None
    """Also write an HTML report here: verdict, cameras, residuals and uncertainty over the field,
    and what was matched."""

    def write_report(self, origin: Mapping[str, Any], **content: Any) -> None:
        """The page, where one is asked for; `origin` is the provenance of the result."""
        if self.report is None:
            return
        from trinoc.cli.command import LOGGER, for_people
        from trinoc.report.html import write_report

        LOGGER.info("writing %s", self.report)
        write_report(self.report, provenance=for_people(origin), **content)


@dataclasses.dataclass(frozen=True, kw_only=True)
class DryRunOption:
    """Of commands that can say what they would do."""

    dry_run: bool = False
    """Read and check everything, say what would be done, and write nothing."""

    def plan(
        self,
        what: str,
        files: Mapping[str, Path],
        sizes_px: Mapping[str, tuple[int, int]],
        outputs: Sequence[Path | None],
    ) -> Outcome:
        """The job in words, each camera with its file and size, and what would be written."""
        lines = [f"would {what}:"]
        for name, file in files.items():
            width, height = sizes_px[name]
            lines.append(f"  {name}: {file}, {width} x {height} px")
        would_write = [path for path in outputs if path is not None]
        for path in would_write:
            lines.append(f"would {'replace' if path.exists() else 'write'} {path}")
        record = {
            "cameras": {name: str(file) for name, file in files.items()},
            "would_write": [str(path) for path in would_write],
        }
        return Outcome("\n".join(lines), record, written=())


@dataclasses.dataclass(frozen=True, kw_only=True)
class Command(abc.ABC):
    """Options that all commands share."""

    json: bool = False
    """Print exactly one JSON object on stdout instead of text."""

    quiet: bool = False
    """Show no progress on stderr."""

    force: bool = False
    """Replace files of another kind."""

    @abc.abstractmethod
    def run(self, command_line: str) -> Outcome:
        """Do the job. Files go where the options say; only `main` prints the outcome.

        `command_line` is what the user typed, for the provenance of files. What takes long to
        import is imported here, so that `--help` is quick.
        """


# Options of commands that name a file to write; all other paths are read.
_WRITTEN = ("out", "report", "plot")
# A rig may take the place of the one that it was made from.
_REPLACED = ("rig", "orientation")
# What all pages and figures of ours hold: a file without it is not theirs to replace.
_MARKS = {"report": b"<!doctype html>", "plot": b"matplotlib"}


def expect_places(command: object) -> None:
    """Raise UsageError where two results, or a result and what it is made of, are one file.

    Raises InputError where a page or a figure would replace something else.
    """
    taken: dict[Path, str] = {}
    kept = {_same(path) for path in _read(command, (*_WRITTEN, *_REPLACED))}
    read = {_same(path) for path in _read(command, _WRITTEN)}
    for name in _WRITTEN:
        path = getattr(command, name, None)
        if not isinstance(path, Path):
            continue
        option, place = f"--{name.replace('_', '-')}", _same(path)
        if place in (kept if name == "out" else read):
            raise UsageError(
                f"{option} is {path}, which is read, and would be lost: give another name."
            )
        if place in taken:
            raise UsageError(
                f"{taken[place]} and {option} are both {path}: give each a name of its own."
            )
        taken[place] = option
        if name == "report" and path.suffix.lower() not in (".html", ".htm"):
            raise UsageError(f"--report is {path}: a report is HTML, choose a name such as r.html.")
        if name in _MARKS:
            from trinoc.io.saving import expect_marked

            expect_marked(path, _MARKS[name], force=getattr(command, "force", False))


def _read(options: object, but: tuple[str, ...]) -> Iterator[Path]:
    """Files that options name, those of groups of options and of NAME=FILE, too."""
    for field in dataclasses.fields(options):  # pyright: ignore[reportArgumentType]
        value = getattr(options, field.name)
        if field.name in but:
            continue
        if dataclasses.is_dataclass(value):
            yield from _read(value, but)
        for each in value if isinstance(value, tuple) else (value,):
            if isinstance(each, Path):
                yield each
            elif isinstance(each, str) and each:
                yield Path(each.partition("=")[2] or each)


def _same(path: Path) -> Path:
    """One path for all names of a file; a name that no file can have stays as it is."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return path


def with_nulls(record: Mapping[str, Any]) -> dict[str, Any]:
    """As JSON can hold it: null for NaN."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in record.items()
    }


def expect_numbers(options: object) -> None:
    """Raise UsageError for an option that is not a number, or infinite where nothing is meant.

    Infinite numbers are taken where the option has one by default.
    """
    for name, value, default in _list_options(options):
        numbers = value if isinstance(value, tuple) else (value,)
        usual = default if isinstance(default, tuple) else (default,)
        for number in numbers:
            if not isinstance(number, float) or math.isfinite(number) or number in usual:
                continue
            raise UsageError(f"--{name.replace('_', '-')} is {number}: give a finite number.")


def _list_options(options: object) -> Iterator[tuple[str, object, object]]:
    """(name, value, default) of every option, those of groups of options, too."""
    for field in dataclasses.fields(options):  # pyright: ignore[reportArgumentType]
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            yield from _list_options(value)
        else:
            yield field.name, value, field.default
