"""Whether the figures come out again: python -m benchmarks.again"""
