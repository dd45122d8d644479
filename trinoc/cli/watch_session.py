"""What `trinoc watch` has judged so far, and how it says it."""

import sys
from typing import TYPE_CHECKING, Any

from trinoc.cli.command import Outcome
from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.calib import AbstractTarget
    from trinoc.capture import Judgement


class WatchSession:
    """What was judged so far, and how it is said."""

    def __init__(self, target: "AbstractTarget", source: str, json: bool, quiet: bool) -> None:
        from trinoc.serving import Watched

        self._target, self._stream = target, sys.stderr if json else sys.stdout
        self._silent = json and quiet
        self.judgements: list[Judgement] = []
        self.written: list[str] = []
        self.watched: Watched = Watched(f"trinoc watch {source}")

    def look(self, name: str, image: "np.ndarray | InputError") -> "Judgement":
        """Judge a picture, and say so."""
        from trinoc.capture import judge, judge_unread, judgement_line, next_step
        from trinoc.serving import thumbnail

        try:
            if isinstance(image, InputError):
                raise image
            judgement = judge(name, image, self._target)
            small = thumbnail(image, judgement)
        except InputError as error:
            judgement, small = judge_unread(name, self._target, str(error)), b""
        # A picture that is written again takes the place of its former self.
        self.judgements = [j for j in self.judgements if j.name != name] + [judgement]
        self.watched = self.watched._replace(judgements=tuple(self.judgements), thumbnail=small)
        if not self._silent:
            advice = f"\n  {next_step(self.judgements)}" if judgement.good else ""
            print(judgement_line(judgement) + advice, file=self._stream, flush=True)
        return judgement

    def outcome(self) -> Outcome:
        """The summary."""
        from trinoc.capture import field_share, next_step, summary_lines

        lines = summary_lines(self.judgements)
        lines += [f"written: {', '.join(self.written)}"] if self.written else []
        record: dict[str, Any] = {
            "pictures": [_record(judgement) for judgement in self.judgements],
            "field": field_share(self.judgements),
            "next": next_step(self.judgements),
            "written": self.written,
        }
        return Outcome("\n".join(lines), record)


def _record(judgement: "Judgement") -> dict[str, Any]:
    return {
        "name": judgement.name,
        "good": judgement.good,
        "found": len(judgement.places_px),
        "of": judgement.of_places,
        "refusal": judgement.refusal,
        "faults": list(judgement.faults),
        "edges_px": _known(judgement.blur_px),
        "saturated": _known(judgement.exposure.saturated),
        "dark": _known(judgement.exposure.dark),
        "lean": list(judgement.lean),
    }


def _known(value: float) -> float | None:
    return value if value == value else None
