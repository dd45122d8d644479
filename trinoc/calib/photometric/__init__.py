"""trinoc/calib/photometric."""
