"""Time and memory by size and by number of Gaussians, and of the kernels: python -m benchmarks.speed"""

# The fewest of one Gaussian on one pixel: two for the recurrence and two for each channel when it is drawn; with its
# gradients another two for the recurrence, and for each channel two for the colour's and two for the weight's.
OPERATIONS = {"forward": 8, "forward + backward": 22}
