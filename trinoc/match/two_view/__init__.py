"""Step 0: epipolar pencil of two views, common part of a pair, interpretation planes."""
