"""Backends: the computations of the encoder that depend on the device.

A backend takes Gaussians, a frame of pixels and a target, and returns errors, gradients, rounded Gaussians and
payloads. protocol.py defines the interface, and kernels.py implements it by the compiled kernels; both are tested
against a definition in float64 (tests/definitions/backend.py). planes.py reduces planes to half the size.
"""
