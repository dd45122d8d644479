"""trinoc/calib/rig_check."""
