"""From a picture of the printed sheet to calibrated cameras with covariance."""
