"""Error against run time, beside other optimisers, networks and codecs: python -m benchmarks.convergence"""
