"""Displays of values in a notebook: tables, small pictures, plots, interactive figures."""
