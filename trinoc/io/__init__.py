"""Files: rigs, patterns, segments, matches and pictures."""
