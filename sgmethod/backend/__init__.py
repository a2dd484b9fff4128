"""Backends: the computations of the encoder that depend on the device.

A backend takes Gaussians, a frame of pixels and a target, and returns errors, gradients, rounded Gaussians and
payloads. protocol.py defines the interface; kernels.py implements it by the compiled kernels, tensors.py by PyTorch on
other devices. devices.py chooses one of the two, and both are tested against a definition in float64
(tests/definitions/backend.py).

tensors.py draws by pairs.py, or on a GPU with Triton by tiles.py and tile_kernels.py; together.py runs the steps of
several fits as one batch. planes.py reduces planes to half the size.
"""
