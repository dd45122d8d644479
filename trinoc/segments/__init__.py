"""trinoc/segments."""
