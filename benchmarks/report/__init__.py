"""The documents' figures from the JSON of benchmarks/results: python -m benchmarks.report"""
