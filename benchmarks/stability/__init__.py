"""Kernels, fits and files at their extremes, each under a rule: python -m benchmarks.stability"""
