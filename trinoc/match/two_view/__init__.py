"""Two views: the pencil of epipolar planes, the common part of a pair, interpretation planes."""
