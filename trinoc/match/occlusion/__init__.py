"""Step 3: segments that two views show and the others do not."""
