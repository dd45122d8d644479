"""What every command is: options that tyro reads, and a `run` that returns what to print."""

import abc
import dataclasses
import re
from typing import Any, NamedTuple

from trinoc.errors import InputError


class UsageError(InputError):
    """The command line itself is wrong: exit status 2 instead of 1."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in a job that keeps what is done; the text says so."""


class Outcome(NamedTuple):
    """What a command has to say: text for people, or one JSON object for programs.

    refusal : why the job counts as failed although there is something to say; None where not.
    """

    text: str
    record: dict[str, Any]
    refusal: str | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Command(abc.ABC):
    """Options that all commands share."""

    json: bool = False
    """Print exactly one JSON object on stdout instead of text."""

    quiet: bool = False
    """Show no progress on stderr."""

    @classmethod
    def command_name(cls) -> str:
        """What the user types: the name of the class in small letters, with hyphens."""
        return re.sub("(?<!^)(?=[A-Z])", "-", cls.__name__).lower()

    @abc.abstractmethod
    def run(self, command_line: str) -> Outcome:
        """Do the job. Files go where the options say; only `main` prints the outcome.

        `command_line` is what the user typed, for the provenance of files. What takes long to
        import is imported here, so that `--help` is quick.
        """
