"""Profile rd: few Gaussians are placed, fitted under the price of their bits, densified, pruned, coded and refined.

A request comes in: pixels, an objective, rate control, a deadline and a backend.
The stream of a version 2 file leaves. encode.py is the pipeline in the order in which it runs.
"""
