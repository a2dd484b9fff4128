"""Measurements, one command each; every result says which machine, commit and date it comes from.

python -m benchmarks.kernels    time of rendering and of its gradients
python -m benchmarks.rd         rate and distortion over a folder of pictures, beside other codecs
python -m benchmarks.chaos      kills and restarts at random while the service works, and the ledger after it
"""
