"""The door to whatever draws, differentiates, steps and refines for the encoder.

Gaussians, a frame of pixels and a target come in; errors, gradients, rounded Gaussians and payloads leave.
protocol.py says what a backend has to offer; kernels.py is the compiled one, reference.py the slow one in float64 that
defines it.
"""
