"""Time and memory by size and by number of Gaussians, and of the kernels: python -m benchmarks.speed"""

FLOPS = 8  # of one Gaussian on one pixel when it is drawn: two for the recurrence, two for each channel
