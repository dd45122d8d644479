"""After matching: collinear tracks as one line, ends that meet as corners, depth maps."""
