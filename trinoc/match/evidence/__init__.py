"""Log likelihood ratios of one line against clutter, and the mixtures learned by EM.

triple_position: place and direction, of pairs too. endpoints: where ends lie along the line.
side_intensity: the darker side and the grey levels on both sides. mixture: their sum."""
