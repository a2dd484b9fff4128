"""Gaussians that were made elsewhere.

arrays.py checks a caller's arrays, packing.py codes them as an .sg file, ply_and_npz.py reads and writes files of other
programs.
"""
