"""What `rigs.py` runs: a file for each table, and what they share."""
