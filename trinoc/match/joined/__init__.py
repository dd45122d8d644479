"""Tracks that lie on one straight line joined, and ends of lines that meet snapped to corners."""
