"""Every number of the method and its source, in one small frozen group per step.

rd.py and paper.py have the settings of the profiles, shared.py the groups that both use. Sections refer to the paper
"Structure-Guided Allocation of 2D Gaussians for Image Representation and Compression". Numbers without a section are
ours: docs/notebook has the measurement behind each, on photographs outside Kodak.
"""
