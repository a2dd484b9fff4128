"""Decoding under load while the service encodes, and its memory: python -m benchmarks.load"""
