"""trinoc/segments/nevatia_babu."""
