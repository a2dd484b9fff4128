"""Measurements, one command each; every result says which machine, commit and date it comes from.

python -m benchmarks.kernels    time of rendering and of its gradients
python -m benchmarks.rd         rate and distortion over a folder of pictures, beside other codecs
"""
