"""After matching: join collinear tracks to one line, and ends that meet to corners."""
