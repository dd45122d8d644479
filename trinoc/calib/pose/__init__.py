"""trinoc/calib/pose."""
