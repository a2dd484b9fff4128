"""Hard pictures, extreme Gaussians and bad starts, each under a rule: python -m benchmarks.robustness"""
