"""The answer of a calibration: status, cameras, covariance, and what each fit says."""
