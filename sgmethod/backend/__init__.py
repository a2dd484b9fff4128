"""The door to whatever draws, differentiates, steps and refines for the encoder.

Gaussians, a frame of pixels and a target come in; errors, gradients, rounded Gaussians and payloads leave.
protocol.py says what a backend has to offer; kernels.py is the compiled one, tensors.py that for other devices, by the
lists of pairs.py, and reference.py the slow one in float64 that defines them. devices.py chooses.
"""
