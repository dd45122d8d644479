"""Parts of `refine.py`: a file for each table."""
