"""trinoc/calib/targets."""
