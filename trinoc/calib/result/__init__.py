"""trinoc/calib/result."""
