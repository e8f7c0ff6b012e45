"""What the theory promises, checked by numbers."""
