"""Straight lines in space, each from all the tracks that lie on it."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.values import Value


class JoinedLines(Value):
    """Lines that one or more tracks show.

    Fields
    ------
    lines_mm : (e, 2, 3) the mean line that all segments of its tracks leave, from the first to
        the last place that a track shows.
    covariance_mm2 : (e, 6, 6) of the ends; along the line, that of the track which ends there.
        It allows for segments that err by more than they say, above all where views disagree or
        only two see the line.
    chi_square, degrees : (e,) misfit of all its segments, and its degrees of freedom; 0 where
        one track is alone.
    line_of_track : (t,) the line of each track of the matches.
    place_mm : (t, 2) where each track begins and ends on its line, from the line's first end.
    px_per_mm : (e,) of its pictures at the line's middle, the mean: image displacement
        per mm across the viewing direction.
    posterior : (e,) the least of its tracks'.
    """

    lines_mm: Float[np.ndarray, "e 2 3"]
    covariance_mm2: Float[np.ndarray, "e 6 6"]
    chi_square: Float[np.ndarray, "e"]
    degrees: Int[np.ndarray, "e"]
    line_of_track: Int[np.ndarray, "t"]
    place_mm: Float[np.ndarray, "t 2"]
    px_per_mm: Float[np.ndarray, "e"]
    posterior: Float[np.ndarray, "e"]

    def __len__(self) -> int:
        return len(self.lines_mm)

    @property
    def pieces(self) -> Int[np.ndarray, "e"]:
        """(e,) number of tracks on each line."""
        return np.bincount(self.line_of_track, minlength=len(self))

    def tracks_of(self, line: int | np.integer) -> Int[np.ndarray, "_"]:
        """The tracks of one line, in order along it."""
        tracks = np.flatnonzero(self.line_of_track == line)
        return tracks[np.argsort(self.place_mm[tracks, 0], kind="stable")]

    def gaps_mm(self, line: int | np.integer) -> Float[np.ndarray, "g 2"]:
        """From where to where no track shows the line, from its first end."""
        return _gaps(self.place_mm[self.tracks_of(line)])

    def overlaps_mm(self, line: int | np.integer) -> Float[np.ndarray, "o 2"]:
        """From where to where two tracks or more show the line, from its first end."""
        place = self.place_mm[self.tracks_of(line)]
        reached = np.maximum.accumulate(place[:, 1])
        again = np.stack([place[1:, 0], np.minimum(reached[:-1], place[1:, 1])], axis=1)
        return again[again[:, 1] > again[:, 0]]


def _gaps(place: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "g 2"]:
    reached = np.maximum.accumulate(place[:, 1])
    gap = np.stack([reached[:-1], place[1:, 0]], axis=1)
    return gap[gap[:, 1] > gap[:, 0]]
