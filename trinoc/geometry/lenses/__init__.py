"""Lens models: one file for each, and the registry of their names."""
