"""From what was selected to `Matches`: more views, 3-D segments with covariance, reasons."""
