"""trinoc/calib/uncertainty."""
