"""Long programs, solved by overlapping windows in time."""
