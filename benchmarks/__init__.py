"""Measurements, one command each; every result says which command, machine, commit and date it comes from.

python -m benchmarks              a small set of all, or with --full what docs/results shows
python -m benchmarks.rd           rate and quality over a folder of pictures, beside other codecs
python -m benchmarks.previews     the same from 32 to 4,096 bytes, beside placeholders and reduced pictures
python -m benchmarks.perceptual   metrics that follow the eye, at equal bytes; .sheet draws crops to look at
python -m benchmarks.convergence  error against run time, beside other codecs
python -m benchmarks.speed        time and memory by size, and of the kernels; growth: large photographs beside AVIF
python -m benchmarks.gpu          drawing, fits, batches and encodes on a GPU, and errors of the kernels there
python -m benchmarks.ablation     profile rd with one part left out at a time, and the paper's ablations
python -m benchmarks.robustness   hard pictures (stiff), extreme Gaussians and bad starts (extremes), under rules
python -m benchmarks.service      the service under load, attacked, and killed at random (chaos)
python -m benchmarks.report       docs/results, its plots and the README's tables from the JSON

benchmarks.page_samples and .page_wall make the pictures of the service's page again. benchmarks.harness is what tests
start, too. The report imports commands, and no command imports the report.
"""
