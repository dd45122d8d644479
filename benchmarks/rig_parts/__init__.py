"""Parts of `rigs.py`: a file for each table, and the code that they share."""
