"""Benchmarks: pairs measured in one run, quoted as ratios of medians. See docs/benchmarks.md."""
