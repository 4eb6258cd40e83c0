"""Benchmarks: ratios and limits measured in one run; speed is never a test."""

from nontwist.geometry.compiled import numba

numba()  # before any other tool makes a function with it, so that all are compiled for the same processor
