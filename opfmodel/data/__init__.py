"""Data from outside: the files they are read from, and their formats."""
