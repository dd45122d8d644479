"""What several rooms need and no library has: arrays, precision, buckets, small solvers.

Ground floor. Nothing here knows cameras, pictures or segments."""
