"""trinoc/evaluation."""
