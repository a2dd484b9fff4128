"""Measurements, one command each; every result says which command, machine, commit and date it comes from.

python -m benchmarks              small versions of most, or with --full what docs/results shows
python -m benchmarks.rd           rate and quality over a folder of pictures, compared with other codecs
python -m benchmarks.previews     the same from 32 to 4,096 bytes, compared with placeholders and reduced pictures
python -m benchmarks.perceptual.sheet  crops of each codec beside the source
python -m benchmarks.convergence  error against run time, compared with other codecs
python -m benchmarks.speed        growth of time with pixels and bytes, against AVIF, and time of the kernels
python -m benchmarks.gpu          drawing, decoding and fits on a GPU
python -m benchmarks.ablation     the paper's ablations, and what its start gains
python -m benchmarks.robustness   hard pictures (stiff), extreme Gaussians and bad starts (extremes), under rules
python -m benchmarks.service      the service under load, attacked, and killed at random (chaos)
python -m benchmarks.scenes       what easy and hard scenes need, and what each saving saves
python -m benchmarks.again        published files of ours, made once more and compared
python -m benchmarks.report       tables and plots of docs/results and README.md from the JSON

Services and pictures to measure come from tests.support; no benchmark imports a test. The report imports commands, and
no command imports the report.
"""
