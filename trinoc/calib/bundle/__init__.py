"""trinoc/calib/bundle."""
