"""trinoc/calib/model."""
