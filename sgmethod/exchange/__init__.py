"""Gaussians that were made elsewhere.

arrays.py checks a caller's arrays, packing.py codes them as an .sg file, files.py reads and writes PLY and npz files of
other programs.
"""
