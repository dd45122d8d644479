"""After matching: corners, edges and planar faces as one consistent graph in space."""
