"""Fuzzing: mutated inputs are accepted, or refused with an error of opfmodel."""
