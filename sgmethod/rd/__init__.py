"""Profile rd: the number of Gaussians, their places and their steps, decided together by rate and distortion.

A request comes in: a picture and what the file may spend.
The bytes of a version 4 file leave; encode.py names the steps in the order in which they run.
"""
