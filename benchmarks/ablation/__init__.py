"""Measure the parts of profile paper: python -m benchmarks.ablation"""
