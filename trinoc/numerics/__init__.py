"""trinoc/numerics."""
