"""Benchmarks: ratios and limits measured in one run; speed is never a test."""
