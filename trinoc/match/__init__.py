"""Segments of two or more views to lines in space, with posterior and covariance.

The method of Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
vision" (1986), on a likelihood that knows every segment's covariance:

0. `observations`, `two_view`: segments in tables; the pencil of epipolar planes of two views; the
   part that a pair of segments has in common.
1. `candidates`: the epipolar constraint restricts, for a segment of one view, a zone in a second; a
   pair found there predicts place and direction in the third view; a third segment that is near and
   nearly parallel makes a triple. All three orderings of the views.
2. `selection`: a segment belongs to one line at each place, which excludes rivals (sum-product
   belief propagation); if a candidate is right, its neighbour is matched at the neighbouring
   position (junctions of 3-D ends).
3. `occlusion`: what only two views show is matched between those two, joined to what is matched.

`evidence` holds the log likelihood ratios that the steps share, and their learning by EM. `tracks`
merges more than three views and puts out `Matches`. `line_map` goes on from there: collinear tracks
as one line, ends that meet as corners. `matcher` is the loop over all of it, `tuning` holds the
constants that users may set."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
