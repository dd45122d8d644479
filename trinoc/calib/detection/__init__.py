"""trinoc/calib/detection."""
