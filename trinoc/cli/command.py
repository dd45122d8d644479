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
    """Send the package's log to stderr: steps as well as warnings, or only warnings."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("trinoc: %(message)s"))
    LOGGER.handlers[:] = [handler]
    LOGGER.setLevel(logging.WARNING if quiet else logging.INFO)
    LOGGER.propagate = False


class UsageError(InputError):
    """The command line itself is wrong: exit status 2 instead of 1."""


class Interruption(KeyboardInterrupt):
    """Ctrl-C in a job that keeps what is done; the text says so."""


class Outcome(NamedTuple):
    """The output of a command: text for people, or one JSON object for programs.

    refusal : why the job counts as failed although there is output; None where it does not.
    written : the files that it left, of which None were not asked for; None for a job that only
        prints.
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
        lines = [f"written: {', '.join(names)}"] if names else []
        return self._replace(
            text="\n".join([self.text, *lines]), record={**self.record, "written": names}
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Job:
    """Options and steps that most commands share.

    json : print one JSON object.
    quiet : show no progress.
    force : overwrite an output file that holds a value of another kind.
    command_line : text that the user typed, for the provenance of files.
    """

    json: bool = False
    quiet: bool = False
    force: bool = False
    command_line: str = ""

    def expect(self, kind: type, out: Path | None, *others: Path | None) -> None:
        """Check, before any work, that a value of type `kind` can be written to `out`.

        others : further output files, of any type.

        Raises InputError.
        """
        from trinoc.io.atomic import expect_place
        from trinoc.io.saving import expect_replaceable

        expect_place(out, *others)
        expect_replaceable(out, kind, force=self.force)

    def provenance(self, inputs: Mapping[str, str | os.PathLike[str]]) -> dict[str, Any]:
        """The "provenance" object of a file; equal inputs give equal objects: it has no date."""
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
        """Write the HTML report, where one is asked for."""
        if report is None:
            return
        from trinoc.report.html import write_report

        LOGGER.info("writing %s", report)
        write_report(report, provenance=for_people(provenance), **content)

    def each(self, items: Collection[_Item], doing: str) -> Iterator[_Item]:
        """The items, with a progress bar on stderr that leaves no trace."""
        bar = Bar(doing, quiet=self.quiet)
        for number, item in enumerate(items):
            bar.show(number, len(items))
            yield item
        bar.close()


def for_people(origin: Mapping[str, Any]) -> dict[str, str]:
    """A provenance as lines of text, for the foot of a report."""
    files = {
        name: f"{entry['file']} (sha256 {entry['sha256'][:12]})"
        for name, entry in origin["inputs"].items()
    }
    return {"command": origin["command"], "version": origin["version"], **files}


class Bar:
    """A progress bar on stderr for work that reports how far it is."""

    def __init__(self, doing: str, *, quiet: bool) -> None:
        self._doing, self._quiet, self._bar = doing, quiet, None

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()

    def show(self, done: int, total: int) -> None:
        """Show that so many of so many are done."""
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
    """The outcome of --dry-run: the job, each camera with its file and size, and the outputs."""
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
    """The named attributes of a value, as JSON can hold them."""
    return {name: as_json(getattr(value, name)) for name in names}


def as_json(value: Any) -> Any:
    """A value as JSON can hold it: lists for arrays and tuples, null for NaN and infinity."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(name): as_json(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
