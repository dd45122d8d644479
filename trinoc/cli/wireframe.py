"""`trinoc wireframe`: corners, edges and planar faces of matches as one graph."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from trinoc.cli.command import Command, Outcome
from trinoc.cli.progress import LOGGER
from trinoc.cli.rig_file import read_rig


@dataclasses.dataclass(frozen=True, kw_only=True)
class Wireframe(Command):
    """Make corners, edges and planar faces of matches: a wire frame to export or to evaluate."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="matches.npz")]
    """What `trinoc match` wrote."""

    rig: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """The cameras that the matches were made with."""

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",))] = Path("wireframe.npz")
    """Where it goes."""

    no_flat: bool = False
    """Do not hold the vertices of each face to its plane."""

    def run(self, command_line: str) -> Outcome:
        """Read, put together, and write."""
        from trinoc.io import expect_ending, expect_place, load_matches, save
        from trinoc.match import Wireframe as Frame, wireframe

        expect_place(self.out)
        expect_ending(self.out, Frame)
        frame = wireframe(load_matches(self.file), read_rig(self.rig), flat=not self.no_flat)
        save(frame, self.out)
        let_go = list(zip(frame.let_go.track.tolist(), frame.let_go.reason.tolist(), strict=True))
        for track, reason in let_go:
            LOGGER.warning("track %d %s", track, reason)
        corners = int(frame.corner.sum())
        shadows = 0 if frame.shadow is None else int((frame.shadow > 0.5).sum())
        record = {
            "edges": len(frame),
            "edges_of_two_views": int((~frame.checked).sum()),
            "corners": corners,
            "free_ends": len(frame.corner) - corners,
            "faces": len(frame.planes),
            "edges_of_shadows": shadows,
            "let_go": [{"track": track, "reason": reason} for track, reason in let_go],
            "written": [str(self.out)],
        }
        text = (
            f"{len(frame)} edges, {record['edges_of_two_views']} of them seen by two views only; "
            f"{corners} corners, {record['free_ends']} free ends, {len(frame.planes)} planar faces"
        )
        if shadows:
            text += f"; {shadows} of the edges are likely of shadows, and bound no face"
        return Outcome(f"{text}\nwritten: {self.out}", record)
