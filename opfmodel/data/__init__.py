"""External data: opening files, and reading their formats."""
