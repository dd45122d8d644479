"""From pictures to segments, and from the segments of several views to tracks in space."""
