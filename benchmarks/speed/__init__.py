"""Time and memory by size, bytes and number of Gaussians, and of the kernels: python -m benchmarks.speed"""
