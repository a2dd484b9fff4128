"""Every number of the method, in one small frozen group for each step, with where it comes from.

Nothing comes in; rd.py and paper.py give the settings of the profiles, shared.py the groups that both have.
Sections are those of the paper "Structure-Guided Allocation of 2D Gaussians for Image Representation and
Compression". Numbers without one are ours: docs/notebook has the measurement that chose each, on photographs that are
not Kodak.
"""
