"""Benchmarks, reported as ratios of medians within one run. See docs/benchmarks.md."""
