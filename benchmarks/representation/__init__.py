"""Quality of a fixed number of Gaussians in floating point, beside networks: python -m benchmarks.representation"""
