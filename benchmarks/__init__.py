"""Measurements, one command each; every result says which machine, commit and date it comes from.

python -m benchmarks.kernels         time of rendering and of its gradients
python -m benchmarks.rd              rate and distortion over a folder of pictures, beside other codecs
python -m benchmarks.stiff           profile rd on pictures that are hard for it, and rules that it keeps there
python -m benchmarks.ablation        profile rd with one part left out at a time
python -m benchmarks.representation  float quality at a fixed number of Gaussians
python -m benchmarks.scaling         time against pixels
python -m benchmarks.load            decoding under load while the service encodes, and its memory
python -m benchmarks.chaos           kills and restarts at random while the service works, and the ledger after it
"""
