"""Gaussians that were made elsewhere.

A caller's arrays come in, and leave as an .sg file; PLY and npz files come in, and leave as Gaussians, and back.
arrays.py checks what comes, packing.py codes it, files.py reads and writes the files of other programs.
"""
