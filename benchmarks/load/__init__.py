"""Decoding under load while the service encodes: python -m benchmarks.load"""
