"""Step 3 of the paper: segments that only two views show."""
