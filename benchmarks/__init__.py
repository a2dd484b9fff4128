"""Measurements, one command each; every result says which command, machine, commit and date it comes from.

python -m benchmarks                 a small set of all, or with --full what docs/results.md shows
python -m benchmarks.rd              rate and distortion over a folder of pictures, beside other codecs
python -m benchmarks.convergence     error against run time, beside other methods and codecs
python -m benchmarks.perceptual      LPIPS, DISTS and SSIMULACRA 2, with and without texture, beside AVIF
python -m benchmarks.needs           what a scene did not need, and the time that it saved
python -m benchmarks.stability       extreme Gaussians, fits and files, each under a rule
python -m benchmarks.stiff           profile rd on pictures that are hard for it, and rules that it keeps there
python -m benchmarks.speed           time and memory by size and by number of Gaussians, and of the kernels
python -m benchmarks.representation  float quality at a fixed number of Gaussians, beside networks
python -m benchmarks.ablation        profile rd with one part left out at a time, and the paper's ablations
python -m benchmarks.turns           encodes and decodes of two checkouts in turns
python -m benchmarks.again           rows drawn by chance, made again: which come out otherwise
python -m benchmarks.report          docs/results.md, its plots and the README's tables from the JSON
python -m benchmarks.load            decoding under load while the service encodes
python -m benchmarks.attacks         what others notice while clients mean harm, and the memory that it takes
python -m benchmarks.chaos           kills and restarts at random while the service works, and the ledger after it
python -m benchmarks.soak            work of every kind for half an hour: memory, files and rows
"""
