"""Time of the kernels, and of encodes by pixels and bytes: python -m benchmarks.speed"""
