"""One plugin of each kind for opfmodel."""
