"""Tests of the commands of benchmarks, on small pictures and for seconds.

What comes in are those commands and benchmarks/results; what leaves is whether the documents are what the JSON says.
"""
