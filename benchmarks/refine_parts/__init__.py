"""What `refine.py` runs: a file for each table."""
